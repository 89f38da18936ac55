"""The demo's benchmark: a version of the dataset, a phase over it, a submission from single sweeps, the board.

**Conventions.** What stands on the platform is used again; splits that are somebody's are never touched. The phase is
over `val`, so its ground truth is open and it may be submitted to as often as one likes.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from stone.splits.splits import PARTS
from stone_client.api import Api
from stone_client.errors import ServerRefusedError
from stone_client.progress import Report
from stone_client.server.benchmarks import phase_path
from stone_client.server.boards import BoardSelection, read_board
from stone_client.server.datasets import publish_dataset, read_dataset
from stone_client.server.job_following import follow
from stone_client.server.sequences import Item
from stone_client.server.splits import current
from stone_client.server.submission import SubmissionDescription, settled, submit
from stone_local.demo.server import DemoServer

PHASE, TEAM, METHOD = "val", "demo", "single sweep, no training"
LICENCE, REASON = "CC0-1.0", "demo"
ABSENT, REFUSED_SPLITS = 404, 422


@dataclass(frozen=True)
class DemoPhase:
    """The phase of the demo's entry: the benchmark's name, which is the sequence's, and the id of its phase."""

    benchmark: str
    phase_id: str


def enter_benchmark(demo_server: DemoServer, sequence: Item, path: Path, progress: Report) -> dict[str, Any] | None:
    """Submit the zip at `path` to a benchmark of this one sequence, as an administrator.

    None where the platform has splits of its own, where a run is too short for any, or where we are no administrator.
    """
    with demo_server.administering() as api:
        stand = benchmark_on_server(api, sequence, progress) if api else None
        return submit_baseline(api, stand, path, progress) if api and stand else None


def benchmark_on_server(api: Api, sequence: Item, progress: Report) -> DemoPhase | None:
    """The benchmark of this one sequence, its ground truth ready; None where it cannot be split."""
    name = str(sequence["name"])
    if not _is_split(api, sequence):
        return None
    _existing_or_made(lambda: read_dataset(api, name), lambda: publish_dataset(api, name, LICENCE, REASON))
    asked = {"name": name, "title": "Demo", "dataset": name, "reason": REASON}
    own = f"/benchmarks/{quote(name, safe='')}"
    _existing_or_made(lambda: api.read(own), lambda: api.create("/admin/benchmarks", asked))
    api.send("PATCH", f"/admin{own}", json={"is_public": True, "reason": REASON})
    phase = api.read(phase_path(name, PHASE))
    if phase["active"] is None:
        made = api.create(f"/admin/phases/{phase['id']}/ground-truths", {"reason": REASON})
        follow(api, made["job"]["id"], progress)
    return DemoPhase(name, phase["id"])


def submit_baseline(api: Api, stand: DemoPhase, path: Path, progress: Report) -> dict[str, Any]:
    """Submit the zip at `path` as a baseline, and read the board. Raises what `settled` raises."""
    entry = SubmissionDescription(stand.phase_id, _team(api), METHOD, "L", kind="baseline")
    submission = settled(api, submit(api, path, entry, progress), progress)
    return {"submission": submission["id"], "board": read_board(api, BoardSelection(stand.benchmark, PHASE))}


def _is_split(api: Api, sequence: Item) -> bool:
    """Whether val is this sequence and nothing else is split; it is made so where nothing is."""
    splits = current(api)
    split = {part: [one["sequence_id"] for one in splits[part]] for part in PARTS}
    wanted = {part: [str(sequence["id"])] if part == "val" else [] for part in PARTS}
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
    """The existing one, else a new one."""
    try:
        return read()
    except ServerRefusedError as error:
        if error.status != ABSENT:
            raise
        return make()


def _team(api: Api) -> str:
    teams = [str(team["id"]) for team in api.pages("/teams") if team["name"] == TEAM]
    return teams[0] if teams else str(api.create("/teams", {"name": TEAM})["id"])
