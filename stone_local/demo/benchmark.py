"""The demo's benchmark: a version of the dataset, a phase over its val, three submissions, the board.

**Conventions.** Existing objects of the platform are reused; splits of other users are never changed. The phase is over
`val`, so its ground truth is open and submissions are unlimited.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar
from urllib.parse import quote

import numpy as np

from stone.splits.splits import PARTS
from stone_client.api import Api
from stone_client.baseline import BaselinePlan, write_baseline
from stone_client.errors import ServerRefusedError
from stone_client.progress import Report
from stone_client.server.benchmarks import download_inputs, fetch_manifest, phase_path
from stone_client.server.boards import BoardSelection, read_board
from stone_client.server.datasets import publish_dataset, read_dataset
from stone_client.server.job_following import follow
from stone_client.server.sequences import Item
from stone_client.server.splits import current
from stone_client.server.submission import SubmissionDescription, settled, submit
from stone_submissions.archive import frame_file, write_files
from stone_submissions.manifest import read_manifest

# The demo's entries: three predictions without training, of the frames of a manifest. Two are baselines, shown without
# a rank; one is the team's ranked entry: the same geometry as the first, from more sweeps.


THREADS = 2
POTENTIALLY_TRAVERSABLE = 2


@dataclass(frozen=True)
class DemoEntry:
    """A submission of the demo: file, method, kind, and the number of sweeps per frame (0: flat ground)."""

    filename: str
    method: str
    kind: str
    sweeps: int


BASELINE = DemoEntry("baseline.zip", "single sweep, no training", "baseline", 1)
ENTRIES = (
    BASELINE,
    DemoEntry("flat.zip", "flat ground", "baseline", 0),
    DemoEntry("sweeps.zip", "10 sweeps, no training", "entry", 10),
)


def write_entry(entry: DemoEntry, manifest: Path, sources: Sequence[Path], progress: Report) -> Path:
    """Write the submission beside the manifest and return its path. Raises what `write_baseline` raises."""
    output = manifest.with_name(entry.filename)
    if not entry.sweeps:
        write_flat_ground(manifest, output)
    else:
        write_baseline(sources, BaselinePlan(manifest, output, THREADS, sweeps=entry.sweeps), progress)
    return output


def write_flat_ground(manifest: Path, output: Path) -> None:
    """Write only potentially traversable ground at the robot's height in every frame."""
    wanted = read_manifest(manifest)
    labels = np.zeros(wanted.grid.shape, np.uint8)
    labels[:, :, round(-wanted.grid.min_m[2] / wanted.grid.voxel_m)] = POTENTIALLY_TRAVERSABLE
    content = frame_file(labels, wanted.grid)
    write_files(output, ((token, content) for token in wanted.tokens))


TEAM = "demo"
LICENCE, REASON = "CC0-1.0", "demo"
ABSENT, REFUSED_SPLITS = 404, 422
Members = Mapping[str, Sequence[Item]]


@dataclass(frozen=True)
class DemoPhase:
    """The phase of the demo's entries: the benchmark's name (the first sequence's name), and the id of its phase."""

    benchmark: str
    phase_id: str
    part: ClassVar[str] = "val"


def benchmark_on_server(api: Api, members: Members, progress: Report) -> DemoPhase | None:
    """Return the benchmark of these sequences by split with its ground truth ready; None if they cannot be split."""
    name = str(members["train"][0]["name"])
    if not _is_split(api, members):
        return None
    _existing_or_made(lambda: read_dataset(api, name), lambda: publish_dataset(api, name, LICENCE, REASON))
    body = {"name": name, "title": "Demo", "dataset": name, "reason": REASON}
    own = f"/benchmarks/{quote(name, safe='')}"
    _existing_or_made(lambda: api.read(own), lambda: api.create("/admin/benchmarks", body))
    api.send("PATCH", f"/admin{own}", json={"is_public": True, "reason": REASON})
    phase = api.read(phase_path(name, DemoPhase.part))
    if phase["active"] is None:
        made = api.create(f"/admin/phases/{phase['id']}/ground-truths", {"reason": REASON})
        follow(api, made["job"]["id"], progress)
    return DemoPhase(name, phase["id"])


def fetch_inputs(api: Api, phase: DemoPhase, folder: Path, progress: Report) -> tuple[Path, list[Path]]:
    """Create the inputs of the phase if it has none, and download the manifest and tars as a participant does."""
    _make_inputs(api, phase, progress)
    at = (phase.benchmark, DemoPhase.part)
    fetch_manifest(api, at, folder / "manifest.json")
    (folder / "inputs").mkdir()
    tars = download_inputs(api, at, folder / "inputs", progress)
    return folder / "manifest.json", [folder / "inputs" / f"{item['name']}.tar" for item in tars]


def _make_inputs(api: Api, phase: DemoPhase, progress: Report) -> None:
    try:
        made = api.create(f"/admin/phases/{phase.phase_id}/inputs", {"reason": REASON})
    except ServerRefusedError as error:
        if error.code != "inputs_complete":
            raise
    else:
        follow(api, made["id"], progress)


def submit_entries(api: Api, phase: DemoPhase, files: Mapping[DemoEntry, Path], progress: Report) -> dict[str, Any]:
    """Submit the zips and read the board; `submission` is the baseline's. Raises what `settled` raises."""
    team = _team(api)
    sent = {
        entry: submit(
            api, path, SubmissionDescription(phase.phase_id, team, entry.method, "L", kind=entry.kind), progress
        )
        for entry, path in files.items()
    }
    scored = {entry: settled(api, submission, progress)["id"] for entry, submission in sent.items()}
    board = read_board(api, BoardSelection(phase.benchmark, DemoPhase.part))
    return {"submission": scored[BASELINE], "submissions": list(scored.values()), "board": board}


def _is_split(api: Api, members: Members) -> bool:
    """Return whether the draft consists of exactly these splits; save them if the draft is empty."""
    splits = current(api)
    split = {part: sorted(item["sequence_id"] for item in splits[part]) for part in PARTS}
    wanted = {part: sorted(str(item["id"]) for item in members.get(part, ())) for part in PARTS}
    if split == wanted or any(split.values()):
        return split == wanted
    match = {"If-Match": f'"{splits["revision"]}"'}
    try:
        api.send("PUT", "/splits", json={**wanted, "reason": REASON}, headers=match)
    except ServerRefusedError as error:
        if error.status != REFUSED_SPLITS:
            raise
        return False
    return True


def _existing_or_made(read: Callable[[], Any], make: Callable[[], Any]) -> Any:
    """Return the existing object, or create it."""
    try:
        return read()
    except ServerRefusedError as error:
        if error.status != ABSENT:
            raise
        return make()


def _team(api: Api) -> str:
    teams = [str(team["id"]) for team in api.pages("/teams") if team["name"] == TEAM]
    return teams[0] if teams else str(api.create("/teams", {"name": TEAM})["id"])
