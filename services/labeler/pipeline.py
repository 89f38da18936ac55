"""From a synchronised sequence to its labels: the page to read first.

fuse → surface → reference → frames, pictures; before them poses are refined where that is asked for. Each stage is
one function of a `Run` and a part of the work; each leaves its result in scratch for the next, so the same stages run
here on a few processes or as queue tasks. Parts are fused in the order of recording, and a tile is reconstructed as
soon as the last part that can reach it is fused (`services/labeler/plan.py`); the reference waits for all tiles, and
the frames for the reference.

**Conventions.** The output folder appears whole or not at all. Its contents (design §4):
`gts/<sequence>/<frame_token>/labels.npz`, `frames.parquet`, `mesh.ply`, `bev.png`, `map.png`, `features.png`,
`thumbnail.jpg`, `scene/` for the viewer, `report.json`, and `sequence.npz`, the synchronised sequence itself, of which
exports are made.
"""

import json
import shutil
from collections import Counter
from collections.abc import Callable, Mapping
from collections.abc import Sequence as Listing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

from services.labeler.costs import Meter
from services.labeler.errors import NoFramesError
from services.labeler.exports.source import SOURCE
from services.labeler.frames import FrameCounts, frames, lay_sight_lines
from services.labeler.fuse import fuse
from services.labeler.map_files import write_map
from services.labeler.parameters import LabelParameters
from services.labeler.plan import Plan, plan_of, surface_where_reached
from services.labeler.refining import Refinement, refined
from services.labeler.report import LabelReport, reference_from, report_of
from services.labeler.run import Run
from services.labeler.surface import TileSummary
from services.labeler.tables import write_frames
from services.labeler.workers import Task, Workers
from services.runtime.atomic import atomic_directory
from services.runtime.run_files import SEQUENCE_FILE
from services.runtime.sequence_file import sequence_bytes
from stone.sequence import Sequence, SweepSource

T = TypeVar("T")
Progress = Callable[[str, int, int], None]
REPORT = "report.json"


@dataclass(frozen=True)
class LabelOptions:
    """How to run, as opposed to what to compute: `workers` never changes a label.

    `source` says where the inputs lay (`recording`, `calibration`: absolute paths), for exports made later on this
    machine; it is written beside the labels as `source.json`. `late_inputs` are hashes that the sequence's `inputs`
    lack, asked for at the end.
    """

    parameters: LabelParameters = field(default_factory=LabelParameters)
    workers: int = 1
    source: Mapping[str, str] = field(default_factory=dict)
    late_inputs: Callable[[], Mapping[str, str]] = dict


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
        stages, refinement = _Stages(workers, progress, Meter()), None
        if options.parameters.refinement is not None:
            refine = Task(("refine poses",), refined, (sequence, sweeps, options.parameters))
            found: dict[tuple[object, ...], tuple[Sequence, Refinement]] = stages.run([refine])
            sequence, refinement = found[refine.key][0], found[refine.key][1].as_record()
        run = Run(sequence, sweeps, options.parameters, staging / ".scratch")
        report = replace(_labelled(run, staging, stages, options.late_inputs), refinement=refinement)
        shutil.rmtree(run.scratch)
        if options.source:
            (staging / SOURCE).write_text(json.dumps(dict(options.source)) + "\n")
        (staging / REPORT).write_text(report.text())
    return report


@dataclass(frozen=True)
class _Stages:
    """Tasks are put to the workers, what they cost is noted, and how far each stage is told."""

    workers: Workers
    progress: Progress
    meter: Meter

    def run(self, tasks: Listing[Task]) -> dict[tuple[object, ...], T]:
        """The result of every task by its key, whose first word is the stage."""
        totals, results = Counter(str(task.key[0]) for task in tasks), dict[tuple[object, ...], T]()
        counts = Counter[str]()
        for stage, total in totals.items():
            self.progress(stage, 0, total)
        for task, done in self.workers.run(tasks):
            stage = str(task.key[0])
            self.meter.note(stage, done)
            results[task.key] = done.value
            counts[stage] += 1
            self.progress(stage, counts[stage], totals[stage])
        return results


def _labelled(run: Run, out: Path, stages: _Stages, late_inputs: Callable[[], Mapping[str, str]]) -> LabelReport:
    plan, labels_root = plan_of(run), out / "gts" / run.sequence.name
    done: dict[tuple[object, ...], TileSummary | None] = stages.run(_map_tasks(run, plan))
    tiles = [tile for tile in (done[("surface", tile)] for tile in sorted(plan.needs)) if tile is not None]
    reference = reference_from(tiles, run.parameters)
    pictures = Task(("pictures",), write_map, (run, tiles, reference, out))
    cut = [Task(("frames", part), frames, (run, part, reference, labels_root)) for part in plan.parts]
    counts: dict[tuple[object, ...], FrameCounts] = stages.run([pictures, *cut])
    sequence = replace(run.sequence, inputs={**late_inputs(), **run.sequence.inputs})
    run = replace(run, sequence=sequence)
    report = report_of(run, tiles, [counts[task.key] for task in cut])
    write_frames(out / "frames.parquet", sequence, report.counts)
    (out / SEQUENCE_FILE).write_bytes(sequence_bytes(sequence))
    return replace(report, costs=stages.meter.as_record())


def _map_tasks(run: Run, plan: Plan) -> list[Task]:
    """All that comes before the reference: each part followed by the tiles that waited for it last."""
    tasks = list[Task]()
    for part in plan.parts:
        tasks.append(Task(("fuse", part), fuse, (run, part)))
        for tile in (tile for tile, parts in plan.needs.items() if parts[-1] == part):
            needs = frozenset(("fuse", one) for one in plan.needs[tile])
            tasks.append(Task(("surface", tile), surface_where_reached, (run, tile), needs))
    cameras = range(len(run.sequence.calibration.of_kind("camera")))
    return [*tasks, *(Task(("sight lines", camera), lay_sight_lines, (run, camera)) for camera in cameras)]
