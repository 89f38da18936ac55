"""One labelling run on this machine: the jobs of `services/labeler/pipeline.py` in a few processes, for `stone label`.

Poses are refined first, if requested.

**Conventions.** The output folder appears atomically. Its contents (design §4):
`gts/<sequence>/<frame_token>/labels.npz`, `frames.parquet`, `mesh.ply`, `bev.png`, `map.png`, `features.png`,
`thumbnail.png`, `scene/` for the viewer, `report.json`, `grid.json`, and `sequence.npz`, the synchronised sequence,
from which exports are made. Labels of a further grid, cropped from the same map, are in `grids/<name>/` with its own
`gts/`, tables and report.
"""

import json
import shutil
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from collections.abc import Sequence as Listing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from services.domain.sequences.run_files import SEQUENCE_FILE
from services.labeler.errors import no_usable_frames
from services.labeler.exports.source import MESH, SOURCE
from services.labeler.map.map_files import map_folder
from services.labeler.map.refinement import refined
from services.labeler.parameters import LabelParameters
from services.labeler.pipeline import FRAMES, STAGES, label_graph
from services.labeler.process_pool import Task, TaskResult, Workers
from services.labeler.report import LabelReport, report_of
from services.labeler.run import LabelRun, silent
from services.labeler.tables import write_frames
from services.runtime.jobs.queries import title_of
from stone.findings import Finding
from stone.sensors.ground_refusals import ground_refusal
from stone.sensors.sequence import Sequence, SweepSource
from stone_base.label_grid import LabelGrid
from stone_files.atomic import atomic_directory
from stone_files.grid_file import GRID_FILE, grid_text
from stone_recordings.joining.joined_recording import JoinedRecording, write_joined
from stone_recordings.sync.sequence_file import sequence_bytes

# The cost of a label set: seconds by stage, processor time and memory.


@dataclass
class CostMeter:
    """Records the cost of every finished task. Stages overlap, so a stage's seconds are the sum over its tasks."""

    busy_s: dict[str, float] = field(default_factory=dict)
    cpu_s: dict[int, float] = field(default_factory=dict)
    peak_bytes: dict[int, int] = field(default_factory=dict)

    def note(self, stage: str, done: TaskResult[Any]) -> None:
        """Add a task's cost; the seconds of the stage "" are not recorded."""
        if stage:
            self.busy_s[stage] = self.busy_s.get(stage, 0.0) + done.busy_s
        self.cpu_s[done.pid] = max(done.cpu_s, self.cpu_s.get(done.pid, 0.0))
        self.peak_bytes[done.pid] = max(done.peak_bytes, self.peak_bytes.get(done.pid, 0))

    def as_record(self) -> dict[str, Any]:
        return {
            "stages_busy_s": {stage: round(busy, 3) for stage, busy in self.busy_s.items()},
            "cpu_s": round(sum(self.cpu_s.values()), 3),
            "peak_bytes": {
                "largest_process": max(self.peak_bytes.values()),
                "all_processes": sum(self.peak_bytes.values()),
            },
        }


TITLE_OF = {stage.shown: title_of(kind) for kind, stage in STAGES.items()}
Progress = Callable[[str, int, int], None]
Key = tuple[object, ...]
REPORT = "report.json"
JOINED_RUN = "recording"
FURTHER = "grids"


@dataclass(frozen=True)
class LabelOptions:
    """Options of the execution: `workers` never changes a label.

    - `source`: absolute paths of the inputs (`recording`, `calibration`), written as `source.json` for later exports
    - `late_inputs`, `late_findings`: hashes and findings to append to the sequence's; called at the end
    - `joined`: the recordings of a joined run, which are linked beside the labels
    - `at_end`: called with the run after all stages, while their results are still in scratch
    """

    parameters: LabelParameters = field(default_factory=LabelParameters)
    workers: int = 1
    source: Mapping[str, str] = field(default_factory=dict)
    late_inputs: Callable[[], Mapping[str, str]] = dict
    late_findings: Callable[[], tuple[Finding, ...]] = tuple
    joined: JoinedRecording | None = None
    at_end: Callable[[LabelRun], None] = lambda _run: None


def label(
    sequence: Sequence,
    sweeps: SweepSource,
    directory: Path,
    options: LabelOptions | None = None,
    progress: Progress = lambda *_: None,
) -> LabelReport:
    """Label every frame of `sequence` into `directory`, replacing an earlier label set there.

    Raises `no_frames` for a sequence without usable frames, `footprint_off_ground` and `poses_tilted` before any
    computation, `no_reference` if the track touches no surface.
    """
    options = options or LabelOptions()
    if len(sequence.frames) == 0:
        raise no_usable_frames(sequence)
    if (refusal := ground_refusal(sequence, options.parameters.footprint_band_m)) is not None:
        raise refusal
    with atomic_directory(directory, replaces=REPORT) as staging, Workers(options.workers) as workers:
        stages, refinement, own = _Stages(workers, progress, CostMeter()), None, len(sequence.findings)
        if options.parameters.refinement is not None:
            task = Task(("refine poses",), refined, (sequence, sweeps, options.parameters))
            sequence, done = stages.run([task])[task.key]
            refinement = done.as_record()
        run = LabelRun(sequence, sweeps, options.parameters, staging / ".scratch", staging / "gts" / sequence.name)
        stages.run(tasks_of(run))
        further = [_at_grid(run, grid) for grid in options.parameters.grids[1:]]
        for other in further:
            stages.run(tasks_of(other, {FRAMES}))
        run = _complete_run(run, options, own)
        for other in further:
            _publish_grid(replace(other, sequence=run.sequence), refinement, options)
        report = _publish_files(run, staging, options)
        report = replace(report, refinement=refinement, costs=stages.meter.as_record())
        (staging / REPORT).write_text(report.text())
    return report


def _at_grid(run: LabelRun, grid: LabelGrid) -> LabelRun:
    """Return the same run with its finished map, for cropping at another grid: its scratch links to the map's files."""
    scratch = run.scratch / FURTHER / grid.name
    scratch.mkdir(parents=True)
    for made in run.scratch.iterdir():
        if made.name not in (FURTHER, "packs"):
            (scratch / made.name).symlink_to(made)
    out = run.scratch.parent / FURTHER / grid.name
    grids = (grid, *(other for other in run.parameters.grids if other != grid))
    parameters = replace(run.parameters, grids=grids)
    return replace(run, parameters=parameters, scratch=scratch, labels_root=out / "gts" / run.sequence.name)


def _publish_grid(run: LabelRun, refinement: Any, options: LabelOptions) -> None:
    """Write the files that scores and exports need; pictures and map are those of the first grid."""
    report, out = (
        replace(report_of(run), refinement=refinement),
        run.scratch.parents[2] / FURTHER / run.parameters.grid.name,
    )
    _write_tables(run, report, out, options)
    shutil.copy(run.scratch.resolve() / "map" / MESH, out / MESH)
    (out / REPORT).write_text(report.text())


def _write_tables(run: LabelRun, report: LabelReport, out: Path, options: LabelOptions) -> None:
    write_frames(out / "frames.parquet", run.sequence, report.counts)
    (out / SEQUENCE_FILE).write_bytes(sequence_bytes(run.sequence))
    (out / GRID_FILE).write_text(grid_text(run.parameters.grid))
    if options.source:
        (out / SOURCE).write_text(json.dumps(dict(options.source)) + "\n")


@dataclass(frozen=True)
class _Stages:
    """Runs tasks in the workers, and records their cost and the progress of each stage."""

    workers: Workers
    progress: Progress
    meter: CostMeter

    def run(self, tasks: Listing[Task]) -> dict[Key, Any]:
        """Return the result of every task by its key; a key starts with its stage, and stage "" has no progress."""
        totals, counts, results = Counter(_stage(task) for task in tasks), Counter[str](), dict[Key, Any]()
        for stage, total in totals.items():
            self._tell(stage, 0, total)
        for task, done in self.workers.run(tasks):
            stage = _stage(task)
            self.meter.note(stage, done)
            results[task.key] = done.value
            counts[stage] += 1
            self._tell(stage, counts[stage], totals[stage])
        return results

    def _tell(self, stage: str, done: int, total: int) -> None:
        if stage:
            self.progress(TITLE_OF.get(stage, stage), done, total)


def _stage(task: Task) -> str:
    return str(task.key[0])


def tasks_of(run: LabelRun, kinds: Collection[str] = STAGES.keys()) -> list[Task]:
    """Return the jobs of a run, except publishing, as tasks for local processes; optionally only some kinds."""
    jobs = [job for job in label_graph(run) if job.kind in kinds]
    keys: dict[str, Key] = {job.key: (STAGES[job.kind].shown, job.key) for job in jobs}
    waits = {job.key: frozenset(keys[need] for need in job.needs if need in keys) for job in jobs}
    return [Task(keys[job.key], STAGES[job.kind].work, (run, job.arguments, silent), waits[job.key]) for job in jobs]


def _complete_run(run: LabelRun, options: LabelOptions, own: int) -> LabelRun:
    """Return the run with late inputs and findings; its `own` findings come first, those of refinement last."""
    sequence, own_findings = run.sequence, run.sequence.findings
    findings = (*own_findings[:own], *options.late_findings(), *own_findings[own:])
    inputs = {**options.late_inputs(), **sequence.inputs}
    return replace(run, sequence=replace(sequence, inputs=inputs, findings=findings))


def _publish_files(run: LabelRun, out: Path, options: LabelOptions) -> LabelReport:
    """Move everything except `report.json` to its final path, delete scratch, and return the report."""
    report = report_of(run)
    options.at_end(run)
    for drawn in map_folder(run).iterdir():
        drawn.replace(out / drawn.name)
    _write_tables(run, report, out, options)
    if options.joined is not None:
        (out / JOINED_RUN).mkdir()
        write_joined(options.joined, out / JOINED_RUN)
    shutil.rmtree(run.scratch)
    return report
