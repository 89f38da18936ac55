"""A submission from exported data by geometry alone: one sweep a frame, no training, the same bytes every time.

**Conventions.** Frames are those of the manifest, in its order and at its grid. A few frames are in memory at a time,
however many there are. Source of the method: `stone/labels/baseline.py`.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from hashlib import file_digest
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

from stone.labels.baseline import DEFAULTS, BaselineParameters, predict_from_sweep
from stone_base.label_grid import PAPER, LabelGrid
from stone_client.progress import Report
from stone_datasets.placed_frames import swept_frames
from stone_exports.files import refuse_missing
from stone_exports.sweeps import SweepFile, sweeps_in
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
    """Which frames to predict (a manifest's path), where to, and by how many threads."""

    manifest: Path
    output: Path
    workers: int
    parameters: BaselineParameters = DEFAULTS


def write_baseline(sources: Sequence[Path], plan: BaselinePlan, progress: Report) -> WrittenBaseline:
    """Predict every frame of the manifest from its own sweep in one of the sources.

    Raises `bad_manifest`, `NotExportedError`, `bad_tar`, `DamagedExportError`, `frames_missing`.
    """
    manifest = read_manifest(plan.manifest)
    sweeps = find_sweeps(sources, manifest)
    frames = ((token, sweeps[token]) for token in manifest.tokens)
    made = _in_order(partial(predicted, parameters=plan.parameters, grid=manifest.grid), frames, plan.workers)
    write_files(plan.output, _with_progress(made, len(manifest.tokens), progress))
    with plan.output.open("rb") as file:
        digest = file_digest(file, "sha256").hexdigest()
    size_bytes = plan.output.stat().st_size
    return WrittenBaseline(str(plan.output), len(manifest.tokens), len(manifest.sequences), size_bytes, digest)


def find_sweeps(sources: Sequence[Path], manifest: Manifest) -> Mapping[str, SweepFile]:
    """The sweep of every frame of the manifest; of several exports that have it, the first named.

    Raises `NotExportedError`, `bad_tar`, `DamagedExportError`, `frames_missing`.
    """
    found, tokens = dict[str, SweepFile](), frozenset(manifest.tokens)
    for source in sources:
        for sweeps in _sweeps_at(source, tokens):
            found = {**sweeps, **found}
    refuse_missing(manifest.sequences, found)
    return found


def _sweeps_at(source: Path, tokens: frozenset[str]) -> Iterator[Mapping[str, SweepFile]]:
    if not is_zip(source):
        yield from (sweeps_in(files, tokens) for files in exports_in(source))
        return
    frames = (frame for frame in swept_frames(source) if frame.token in tokens)
    yield {frame.token: SweepFile(frame.lidar.span, frame.lidar.sensor.ego_from_sensor) for frame in frames}


def predicted(
    frame: tuple[str, SweepFile], parameters: BaselineParameters = DEFAULTS, grid: LabelGrid = PAPER
) -> Frame:
    """The file of one frame, predicted at the grid. Raises `DamagedExportError`."""
    token, sweep = frame
    return token, frame_file(predict_from_sweep(sweep.points_ego(), parameters, grid), grid)


def _with_progress(frames: Iterable[Frame], total: int, progress: Report) -> Iterator[Frame]:
    for done, frame in enumerate(frames, start=1):
        yield frame
        progress("predict", done, total)


def _in_order(work: Callable[[T], Frame], items: Iterator[T], workers: int) -> Iterator[Frame]:
    """The results in the order of the items, a few ahead of whoever takes them."""
    with ThreadPoolExecutor(workers) as pool:
        waiting = deque[Future[Frame]]()
        try:
            waiting.extend(pool.submit(work, item) for item in islice(items, workers + AHEAD))
            while waiting:
                yield waiting.popleft().result()
                waiting.extend(pool.submit(work, item) for item in islice(items, 1))
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
