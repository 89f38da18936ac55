"""From a synchronised sequence to its labels: the page to read first.

fuse → surface → reference → frames → pictures. Each stage is one function of a `Run` and a part of the work; each
leaves its result in scratch for the next, so the same stages run here on a few processes or as queue tasks.

**Conventions.** The output folder appears whole or not at all. Its contents (design §4):
`gts/<sequence>/<frame_token>/labels.npz`, `frames.parquet`, `mesh.ply`, `bev.png`, `report.json`.
"""

import shutil
import time
from collections.abc import Callable, Iterator
from collections.abc import Sequence as Listing
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

from services.labeler.errors import NoFramesError
from services.labeler.frames import frames, lay_sight_lines
from services.labeler.fuse import fuse
from services.labeler.map_files import write_map
from services.labeler.parameters import LabelParameters
from services.labeler.report import LabelReport, Meter, reference_from, report_of
from services.labeler.run import Run, Tile, largest_first, parts_of
from services.labeler.scratch import tile_named
from services.labeler.surface import surface
from services.labeler.tables import write_frames
from services.labeler.workers import Workers
from services.runtime.atomic import atomic_directory
from stone.sequence import Sequence, SweepSource

T = TypeVar("T")
Progress = Callable[[str, int, int], None]
REPORT = "report.json"


@dataclass(frozen=True)
class LabelOptions:
    """How to run, as opposed to what to compute: `workers` never changes a label."""

    parameters: LabelParameters = field(default_factory=LabelParameters)
    workers: int = 1


def label(
    sequence: Sequence,
    sweeps: SweepSource,
    directory: Path,
    options: LabelOptions | None = None,
    progress: Progress = lambda *_: None,
) -> LabelReport:
    """Label every frame of `sequence` into `directory`, replacing an earlier label set there.

    Raises `NoFramesError` for a sequence without usable frames, `NoReferenceError` when the track touches no surface.
    """
    options = options or LabelOptions()
    if len(sequence.frames) == 0:
        raise NoFramesError(sequence)
    with atomic_directory(directory, replaces=REPORT) as staging, Workers(options.workers) as workers:
        run = Run(sequence, sweeps, options.parameters, staging / ".scratch")
        report = _labelled(run, staging, _Stages(workers, progress, Meter()))
        shutil.rmtree(run.scratch)
        (staging / REPORT).write_text(report.text())
    return report


@dataclass(frozen=True)
class _Stages:
    workers: Workers
    progress: Progress
    meter: Meter

    def run(self, name: str, task: Callable[..., T], arguments: Listing[tuple[object, ...]]) -> list[T]:
        """All results of one stage, in order, reporting progress as they come."""
        results = []
        with self.timed(name):
            self.progress(name, 0, len(arguments))
            for done in self.workers.run(task, arguments):
                self.meter.note(done)
                results.append(done.value)
                self.progress(name, len(results), len(arguments))
        return results

    @contextmanager
    def timed(self, name: str) -> Iterator[None]:
        begin = time.perf_counter()
        yield
        self.meter.wall_s[name] = time.perf_counter() - begin


def _labelled(run: Run, out: Path, stages: _Stages) -> LabelReport:
    parts = parts_of(run)
    cameras = range(len(run.sequence.calibration.of_kind("camera")))
    labels_root = out / "gts" / run.sequence.name
    stages.run("fuse", fuse, [(run, part) for part in parts])
    tiles = stages.run("surface", surface, [(run, tile) for tile in largest_first(_fused_bytes(run))])
    tiles.sort(key=lambda summary: summary.tile)
    reference = reference_from(tiles, run.parameters)
    stages.run("sight lines", lay_sight_lines, [(run, camera) for camera in cameras])
    counts = stages.run("frames", frames, [(run, part, reference, labels_root) for part in parts])
    stages.run("pictures", write_map, [(run, tiles, reference, out)])
    report = report_of(run.sequence, run.parameters, tiles, counts)
    write_frames(out / "frames.parquet", run.sequence, report.counts)
    return replace(report, costs=stages.meter.as_record())


def _fused_bytes(run: Run) -> dict[Tile, int]:
    """Every tile that any point fell into, and how much of it there is."""
    folders = (run.scratch / "fused").glob("*_*")
    return {tile_named(folder.name): sum(path.stat().st_size for path in folder.iterdir()) for folder in folders}
