"""From a synchronised sequence to its labels: the page to read first.

fuse → surface → reference → frames → pictures. Each stage is one function of a `Run` and a part of the work; each
leaves its result in scratch for the next, so the same stages run here on a few processes or as queue tasks.

**Conventions.** The output folder appears whole or not at all. Its contents (design §4):
`gts/<sequence>/<frame_token>/labels.npz`, `frames.parquet`, `mesh.ply`, `bev.png`, `report.json`.
"""

import json
import shutil
import time
from collections.abc import Callable, Iterator
from collections.abc import Sequence as Listing
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from services.labeler.errors import NoFramesError
from services.labeler.frames import frames, labelled_tile, lay_sight_lines
from services.labeler.fuse import fuse
from services.labeler.parameters import LabelParameters
from services.labeler.picture import TopView, write_top_view
from services.labeler.ply import Piece, class_at, write_mesh
from services.labeler.report import LabelReport, Meter, label_findings
from services.labeler.run import Run, Tile, parts_of
from services.labeler.scratch import fused_tiles
from services.labeler.surface import TileSummary, surface
from services.labeler.tables import concatenated, write_frames
from services.labeler.workers import Workers
from services.runtime.atomic import atomic_directory
from stone.sequence import Sequence, SweepSource
from stone.traversability import Reference, reference_of, total_of

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
        stages = _Stages(workers, progress, Meter())
        report = _labelled(run, staging, stages)
        shutil.rmtree(run.scratch)
        (staging / REPORT).write_text(json.dumps(report.as_record(), indent=1) + "\n")
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
    labels_root = out / "gts" / run.sequence.name
    stages.run("fuse", fuse, [(run, part) for part in parts])
    tiles = stages.run("surface", surface, [(run, tile) for tile in _largest_first(run)])
    tiles.sort(key=lambda summary: summary.tile)
    reference = reference_of(total_of([tile.sums for tile in tiles]), run.parameters.reference)
    stages.run("sight lines", lay_sight_lines, [(run, mount) for mount in run.sequence.calibration.of_kind("camera")])
    counts = concatenated(stages.run("frames", frames, [(run, part, reference, labels_root) for part in parts]))
    stages.run("pictures", write_pictures, [(run, tiles, reference, out)])
    write_frames(out / "frames.parquet", run.sequence, counts)
    findings = (*run.sequence.findings, *label_findings(run.sequence, run.parameters, reference, counts))
    return LabelReport(
        run.sequence, run.parameters, version("stone-platform"), reference, tuple(tiles), counts, stages.meter, findings
    )


def _largest_first(run: Run) -> list[Tile]:
    """All tiles, the heaviest first, so that no worker is left alone with a big one at the end."""
    weight = {
        tile: sum(path.stat().st_size for path in (run.scratch / "fused" / f"{tile[0]}_{tile[1]}").iterdir())
        for tile in fused_tiles(run)
    }
    return sorted(weight, key=lambda tile: (-weight[tile], tile))


def write_pictures(run: Run, tiles: list[TileSummary], reference: Reference, out: Path) -> None:
    """`bev.png` and `mesh.ply`, tile by tile."""
    view = TopView({})
    for summary in tiles:
        arrays, classes = labelled_tile(run, summary.tile, reference)
        view.add(summary.tile, arrays["keys"], classes)  # type: ignore[arg-type]
    write_top_view(out / "bev.png", view, run.sequence.frames.map_from_ego)
    totals = (sum(tile.vertices for tile in tiles), sum(tile.triangles for tile in tiles))
    write_mesh(out / "mesh.ply", totals, [partial(_piece, run, tile.tile, reference) for tile in tiles])


def _piece(run: Run, tile: Tile, reference: Reference) -> Piece:
    arrays, classes = labelled_tile(run, tile, reference)
    vertices: NDArray[np.float32] = arrays["vertices"]  # type: ignore[assignment]
    return vertices, arrays["triangles"], class_at(vertices, arrays["keys"], classes)  # type: ignore[return-value,arg-type]
