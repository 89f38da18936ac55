"""The demo: simulate, upload, process, download, export, predict, submit, and show the leaderboard.

**Conventions.** All steps up to the labels use a server's API, as in the field. All output is in one folder, which
appears whole or not at all; `demo.json` marks it as the demo's, so that the next demo may replace it.
"""

import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, replace
from itertools import count
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from services.eval.pipeline import score
from services.runtime.embedded.first_start import first_password_file
from services.runtime.embedded.supervisor import RunningPlatform
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from stone.splits.splits import SHORTEST_S
from stone_client.api import Api
from stone_client.credentials import Server
from stone_client.errors import ServerRefusedError
from stone_client.files.bags import LocalBag, hashed_bag
from stone_client.files.label_download import download_labels
from stone_client.progress import Report
from stone_client.server.exports import download_archive, make_export
from stone_client.server.job_following import follow
from stone_client.server.sequences import (
    Item,
    add_recording,
    ensure_sequence,
    find_sequence,
    has_other_recording,
    pin_calibration,
    start_run,
)
from stone_client.sign_in import administering
from stone_local.demo.benchmark import (
    BASELINE,
    ENTRIES,
    DemoPhase,
    benchmark_on_server,
    fetch_inputs,
    submit_entries,
    write_entry,
)
from stone_local.frame_order import TABLE, in_time_order
from stone_submissions.ground_truth import find_ground_truth
from stone_submissions.manifest import write_manifest
from stone_submissions.validation import validate
from stone_submissions.verdict import SubmissionRefusedError

# The demo's runs: robots, recording conditions and recordings. The first run (train) has cameras and 10 sweeps per
# second. The other two are val and cheap: LiDAR only, 2 sweeps per second, at 4 m/s. Neighbouring frames overlap, so an
# interval needs metres of track: 480 m suffice for the mIoU, the 30 m of the first run do not.


SEQUENCE = "demo"
TRAIN, VAL = "train", "val"
SPARSE = SimulateOptions(
    seconds=60.0, channels=32, columns=450, cameras=False, lidar_hz=2, speed_m_s=4.0, world_width_m=80.0,
    host_delay_max_ns=0,
)  # fmt: skip


@dataclass(frozen=True)
class DemoRun:
    """A run: the name of its sequence, its split, its robot, and the recording conditions."""

    name: str
    part: str
    simulation: SimulateOptions
    conditions: Mapping[str, str]


@dataclass(frozen=True)
class DemoRecording:
    """A recorded run and its folder."""

    run: DemoRun
    folder: Path

    @property
    def bag(self) -> Path:
        return self.folder / "run.mcap"

    @property
    def calibration(self) -> Path:
        return calibration_path(self.bag)

    @property
    def labels(self) -> Path:
        return self.folder / "labels"


def demo_runs(shown: SimulateOptions) -> tuple[DemoRun, ...]:
    """Return the runs of a demo with this robot: all runs, or only the first if it is too short for a split."""
    day = DemoRun(SEQUENCE, TRAIN, shown, _conditions("mountain", "day", "north"))
    if shown.seconds < SHORTEST_S:
        return (day,)
    dusk, night = (replace(SPARSE, seed=seed, illumination=light) for seed, light in ((31, "dusk"), (32, "night")))
    return (
        day,
        DemoRun(f"{SEQUENCE}-dusk", VAL, dusk, _conditions("mountain", "dusk", "south")),
        DemoRun(f"{SEQUENCE}-night", VAL, night, _conditions("mountain", "night", "east")),
    )


def recorded_runs(folder: Path, runs: tuple[DemoRun, ...], progress: Report) -> Sequence[DemoRecording]:
    """Yield the recordings in `folder`, in the order of the runs: the first is made here, the others in parallel."""
    first, *others = (DemoRecording(run, folder / run.name.removeprefix(SEQUENCE).lstrip("-")) for run in runs)
    with ProcessPoolExecutor(max(1, len(others)), get_context("spawn")) as pool:
        for recording in others:
            recording.folder.mkdir()
        made = [pool.submit(simulate, recording.bag, recording.run.simulation) for recording in others]
        simulate(first.bag, first.run.simulation, folder / "truth", progress)
        for is_made in made:
            is_made.result()
    return first, *others


def _conditions(environment: str, illumination: str, region: str) -> Mapping[str, str]:
    return {"environment": environment, "illumination": illumination, "region": region, "platform": "simulated"}


# The server of the demo: started for it on this machine, or remote. The benchmark requires an administrator: locally
# the first one, if the initial password is unchanged; on a remote server the token's user, if it is an administrator.


UNKNOWN_PASSWORD = 401
Administering = Callable[[], AbstractContextManager[Api | None]]


@dataclass(frozen=True)
class DemoServer:
    """A running platform; `administering()` yields its API for an administrator, or None."""

    server: Server
    administering: Administering


def demo_server_of(platform: RunningPlatform | Server) -> DemoServer:
    """Return the server after it has answered. Raises `StartFailedError`."""
    if isinstance(platform, Server):
        return DemoServer(platform, lambda: _by_token(platform))
    platform.wait_until_ready()
    return DemoServer(Server(platform.url, platform.keys.token), lambda: _by_first_password(platform))


@contextmanager
def _by_token(server: Server) -> Iterator[Api | None]:
    with Api(server) as api:
        yield api if "admin" in api.read("/me")["scopes"] else None


@contextmanager
def _by_first_password(running: RunningPlatform) -> Iterator[Api | None]:
    path = first_password_file(running.platform.settings)
    with ExitStack() as stack:
        api = None
        if path:
            signed_in = administering(running.url, running.keys.name, path.read_text("utf-8").strip())
            with _unless_the_password_is_another():
                api = stack.enter_context(signed_in)
        yield api


@contextmanager
def _unless_the_password_is_another() -> Iterator[None]:
    try:
        yield
    except ServerRefusedError as error:
        if error.status != UNKNOWN_PASSWORD:
            raise


MARK = "demo.json"
EXPORTED = "nuscenes"
TRUTH = "ground-truth"


@dataclass(frozen=True)
class DemoPlan:
    """The simulation, and the platform for its labels: our own, possibly still starting, or a server."""

    simulation: SimulateOptions
    platform: RunningPlatform | Server

    @property
    def runs(self) -> tuple[DemoRun, ...]:
        return demo_runs(self.simulation)


@dataclass(frozen=True)
class LabelledRun:
    """A run with labels, and its sequence on the server."""

    recording: DemoRecording
    sequence: Item


def run_demo(folder: Path, plan: DemoPlan, progress: Report) -> dict[str, Any]:
    """Fill `folder` and return the record that `demo.json` contains."""
    recordings = recorded_runs(folder, plan.runs, progress)
    demo_server = demo_server_of(plan.platform)
    with Api(demo_server.server) as api:
        labelled = label_on_server(api, recordings, progress)
        exported = export_on_server(api, labelled[0].sequence, folder, progress)
    scores, benchmark = enter_benchmark(demo_server, labelled, folder, progress)
    labels = json.loads((folder / "labels" / "report.json").read_text("utf-8"))
    record = {
        "url": demo_server.server.url,
        "sequence": labelled[0].sequence["name"],
        "view": f"/sequences/{labelled[0].sequence['id']}/view",
        "sequences": [labelled_run.sequence["name"] for labelled_run in labelled],
        "labels": labels,
        "export": exported,
        "baseline": scores,
        "benchmark": benchmark,
    }
    (folder / MARK).write_text(json.dumps(record, indent=1, allow_nan=False) + "\n")
    return record


def label_on_server(api: Api, recordings: Sequence[DemoRecording], progress: Report) -> Sequence[LabelledRun]:
    """Label the sequences and download their labels into the folders of their runs.

    The first sequence is processed last, because the first page shows the newest labels.
    """
    first, *others = recordings
    started = list[tuple[DemoRecording, Item, str]]()
    for recording in others:
        sequence = _uploaded(api, recording, progress)
        started.append((recording, sequence, _started(api, sequence)))
    sequence = _uploaded(api, first, progress)
    labelled = [_finished(api, *of_one, progress) for of_one in started]
    return _finished(api, first, sequence, _started(api, sequence), progress), *labelled


def _uploaded(api: Api, recording: DemoRecording, progress: Report) -> Item:
    local = hashed_bag(recording.bag, progress)
    sequence = _free_sequence(api, recording.run.name, local)
    show_to_anybody(api, sequence, recording.run)
    pin_calibration(api, sequence, recording.calibration)
    add_recording(api, sequence, local, progress)
    return sequence


def _started(api: Api, sequence: Item) -> str:
    """Start labelling the sequence; return the id of the job."""
    return str(start_run(api, sequence, {})["id"])


def _finished(api: Api, recording: DemoRecording, sequence: Item, job_id: str, progress: Report) -> LabelledRun:
    follow(api, job_id, progress)
    labelled = find_sequence(api, sequence["id"])
    download_labels(api, labelled, recording.labels, progress)
    return LabelledRun(recording, labelled)


def show_to_anybody(api: Api, sequence: Item, run: DemoRun) -> None:
    """Set the recording conditions and make the sequence public, so that the first page shows it without an account."""
    sequence_now = find_sequence(api, sequence["id"])
    match = {"If-Match": f'"{sequence_now["revision"]}"'}
    api.send("PATCH", f"/sequences/{sequence['id']}", json={"is_public": True, **run.conditions}, headers=match)


def export_on_server(api: Api, sequence: Item, folder: Path, progress: Report) -> dict[str, Any]:
    """Download the release layout of the sequence as `nuscenes.tar`; return a record of it."""
    export = make_export(api, sequence, EXPORTED, progress)
    arrived = download_archive(api, export, folder / f"{EXPORTED}.tar", progress)
    return {"format": EXPORTED, "files": export["files"], **{key: arrived[key] for key in ("size_bytes", "sha256")}}


def enter_benchmark(
    demo_server: DemoServer, labelled: Sequence[LabelledRun], folder: Path, progress: Report
) -> tuple[dict[str, Any], dict[str, Any] | None]:
    """Return the local score of the baseline, and the board with the entries.

    There is no board if the platform has other splits, a run is too short for a split, or the caller is no
    administrator. Then the baseline predicts the first run.
    """
    with demo_server.administering() as api:
        by_part = {labelled_run.recording.run.part: list[Item]() for labelled_run in labelled}
        for labelled_run in labelled:
            by_part[labelled_run.recording.run.part].append(labelled_run.sequence)
        phase = benchmark_on_server(api, by_part, progress) if api and len(by_part) > 1 else None
        if api is None or phase is None:
            return score_baseline(
                _of_first_run(folder), [folder / f"{EXPORTED}.tar"], folder / "labels", progress
            ), None
        return _entered(api, phase, labelled, folder, progress)


def _entered(
    api: Api, phase: DemoPhase, labelled: Sequence[LabelledRun], folder: Path, progress: Report
) -> tuple[dict[str, Any], dict[str, Any]]:
    gather_truth(labelled, folder / TRUTH)
    manifest, sources = fetch_inputs(api, phase, folder, progress)
    scores = score_baseline(manifest, sources, folder / TRUTH, progress)
    files = {entry: write_entry(entry, manifest, sources, progress) for entry in ENTRIES if entry is not BASELINE}
    return scores, submit_entries(api, phase, {BASELINE: folder / BASELINE.filename, **files}, progress)


def gather_truth(labelled: Sequence[LabelledRun], truth: Path) -> None:
    """Move the labels of the phase's frames below one folder, as `stone score` reads them."""
    (truth / "gts").mkdir(parents=True)
    for labelled_run in labelled:
        if labelled_run.recording.run.part == DemoPhase.part:
            name = str(labelled_run.sequence["name"])
            (labelled_run.recording.labels / "gts" / name).rename(truth / "gts" / name)
            shutil.copyfile(labelled_run.recording.labels / TABLE, truth / "gts" / name / TABLE)


def score_baseline(manifest: Path, sources: Sequence[Path], truth: Path, progress: Report) -> dict[str, Any]:
    """Predict every frame from its own sweep, validate the submission and score it against the local labels.

    Raises `SubmissionRefusedError`.
    """
    output = write_entry(BASELINE, manifest, sources, progress)
    validation = validate(output, manifest, progress=progress)
    if not validation.ok:
        raise SubmissionRefusedError(validation)
    return score(output, truth, progress=progress, order=in_time_order).as_record()


def _of_first_run(folder: Path) -> Path:
    """Write the manifest of the first run's frames and return its path."""
    write_manifest(folder / "manifest.json", find_ground_truth(folder / "labels").manifest)
    return folder / "manifest.json"


def _free_sequence(api: Api, name: str, local: LocalBag) -> Item:
    """Return the sequence `demo`, or `demo-2`, … if another recording has that name: the user's data are never
    replaced.
    """
    for number in count(1):
        sequence = ensure_sequence(api, name if number == 1 else f"{name}-{number}")
        if not has_other_recording(api, sequence, local):
            return sequence
    raise AssertionError
