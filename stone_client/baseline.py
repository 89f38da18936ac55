"""A submission from exported data by geometry alone: no training, the same bytes every time.

**Conventions.** Frames, their order and their grid are those of the manifest. The prediction of a frame uses its own
sweep and optionally the latest earlier sweeps of its sequence, never later ones. Only a few frames are in memory at a
time. Method: `stone/labels/baseline.py`.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from stone.labels.baseline import DEFAULTS, BaselineParameters, predict_from_sweep
from stone_base.label_grid import PAPER, LabelGrid
from stone_base.newer_python import file_digest
from stone_client.progress import Report
from stone_datasets.placed_frames import swept_frames
from stone_exports.files import refuse_missing
from stone_exports.sweeps import PlacedSweep, sweeps_in
from stone_exports.tables import exports_in
from stone_files.dataset_layout import is_zip
from stone_submissions.archive import frame_file, write_files
from stone_submissions.manifest import Manifest, read_manifest

AHEAD = 3
T = TypeVar("T")
Frame = tuple[str, bytes]


@dataclass(frozen=True)
class WrittenBaseline:
    """The record of a written baseline submission."""

    output: str
    frames: int
    sequences: int
    size_bytes: int
    sha256: str

    def as_record(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(frozen=True)
class BaselinePlan:
    """The frames to predict (path of a manifest), the output and the number of threads."""

    manifest: Path
    output: Path
    workers: int
    parameters: BaselineParameters = DEFAULTS
    sweeps: int = 1


@dataclass(frozen=True, eq=False)
class Drive:
    """The sweeps of a sequence in time order."""

    sweeps: tuple[PlacedSweep, ...]

    def until(self, at: int, most: int) -> tuple[NDArray[np.float32], NDArray[np.float64] | None]:
        """Return the points (N, 3) of the latest `most` sweeps up to `at`, and the track (M, 2) before it, ego frame.

        There is no track if only one sweep is wanted. Raises `DamagedExportError`.
        """
        now = self.sweeps[at]
        if most == 1:
            return now.points_ego(), None
        ego_from_global = now.global_from_ego.inverse()
        points = [now.points_ego()]
        for earlier in self.sweeps[max(0, at - most + 1) : at]:
            now_from_then = ego_from_global @ earlier.global_from_ego
            points.append((now_from_then @ earlier.points_ego().astype(np.float64)).astype(np.float32))
        places = [(ego_from_global @ earlier.global_from_ego).translation_m[:2] for earlier in self.sweeps[:at]]
        return np.concatenate(points), np.array(places).reshape(-1, 2)


def write_baseline(sources: Sequence[Path], plan: BaselinePlan, progress: Report) -> WrittenBaseline:
    """Predict every frame of the manifest from its own sweep, and the earlier ones that the plan names, in the sources.

    Raises `bad_manifest`, `NotExportedError`, `bad_tar`, `DamagedExportError`, `frames_missing`.
    """
    manifest = read_manifest(plan.manifest)
    drives = _drives(find_sweeps(sources, manifest), manifest)
    frames = ((token, *drives[token]) for token in manifest.tokens)
    made = _in_order(partial(predicted, plan=plan, grid=manifest.grid), frames, plan.workers)
    write_files(plan.output, _with_progress(made, len(manifest.tokens), progress))
    with plan.output.open("rb") as file:
        digest = file_digest(file, "sha256").hexdigest()
    size_bytes = plan.output.stat().st_size
    return WrittenBaseline(str(plan.output), len(manifest.tokens), len(manifest.sequences), size_bytes, digest)


def find_sweeps(sources: Sequence[Path], manifest: Manifest) -> Mapping[str, PlacedSweep]:
    """Return the sweep of every frame of the manifest, from the first source that contains it.

    Raises `NotExportedError`, `bad_tar`, `DamagedExportError`, `frames_missing`.
    """
    sweep_of, tokens = dict[str, PlacedSweep](), frozenset(manifest.tokens)
    for source in sources:
        for sweeps in _sweeps_at(source, tokens):
            sweep_of = {**sweeps, **sweep_of}
    refuse_missing(manifest.sequences, sweep_of)
    return sweep_of


def _sweeps_at(source: Path, tokens: frozenset[str]) -> Iterator[Mapping[str, PlacedSweep]]:
    if not is_zip(source):
        yield from (sweeps_in(files, tokens) for files in exports_in(source))
        return
    frames = ((frame.token, frame.lidar) for frame in swept_frames(source) if frame.token in tokens)
    yield {
        token: PlacedSweep(lidar.span, lidar.sensor.ego_from_sensor, lidar.stamp_us, lidar.global_from_ego)
        for token, lidar in frames
    }


def _drives(sweeps: Mapping[str, PlacedSweep], manifest: Manifest) -> Mapping[str, tuple[Drive, int]]:
    """Return the drive of each frame by token, and the frame's index in the drive."""
    drives = dict[str, tuple[Drive, int]]()
    for tokens in manifest.sequences.values():
        ordered = sorted(tokens, key=lambda token: sweeps[token].stamp_us)
        drive = Drive(tuple(sweeps[token] for token in ordered))
        drives.update((token, (drive, at)) for at, token in enumerate(ordered))
    return drives


def predicted(frame: tuple[str, Drive, int], plan: BaselinePlan, grid: LabelGrid = PAPER) -> Frame:
    """Return the file of one frame, predicted at the grid. Raises `DamagedExportError`."""
    token, drive, at = frame
    points_ego, track_m = drive.until(at, plan.sweeps)
    return token, frame_file(predict_from_sweep(points_ego, plan.parameters, grid, track_m), grid)


def _with_progress(frames: Iterable[Frame], total: int, progress: Report) -> Iterator[Frame]:
    for done, frame in enumerate(frames, start=1):
        yield frame
        progress("predict", done, total)


def _in_order(work: Callable[[T], Frame], items: Iterator[T], workers: int) -> Iterator[Frame]:
    """Yield the results in the order of the items; a few are computed ahead of the consumer."""
    with ThreadPoolExecutor(workers) as pool:
        waiting = deque[Future[Frame]]()
        try:
            waiting.extend(pool.submit(work, item) for item in islice(items, workers + AHEAD))
            while waiting:
                yield waiting.popleft().result()
                waiting.extend(pool.submit(work, item) for item in islice(items, 1))
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
