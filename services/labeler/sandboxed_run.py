"""The work of a sandboxed child with the files of a labelling run, and the checks of its answers.

    files of the run → the run as a value → (its jobs | a job's inputs | a job's work | its publication)

**Conventions.** All files of the run follow from untrusted data, so only the child opens them; the parent moves files
by name and accepts JSON of a known form (`child_answers.py`). The child writes within the run's folder, makes no links,
and reads the recording only if its stage reads sweeps.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from services.domain.sequences.run_files import SEQUENCE_FILE, SWEEPS_FILE
from services.labeler.child_answers import FilesAnswer, GraphAnswer, JobAnswer, WorkAnswer
from services.labeler.errors import no_usable_frames
from services.labeler.parameters import chosen_parameters
from services.labeler.pipeline import FUSE, STAGES, SURFACE, label_graph
from services.labeler.publication_files import publication
from services.labeler.run import LabelRun
from services.labeler.scratch import recorded_writes
from services.runtime.jobs.specs import JobSpec
from services.runtime.sandbox import ProgressCallback
from stone.sensors.sequence import Sequence, Sweep, SweepSource
from stone_base.label_grid import PAPER, LabelGrid
from stone_recordings.sync.sequence_file import read_sequence
from stone_recordings.sync.sweeps import read_sweeps


@dataclass
class LateSweeps:
    """Sweeps that are opened at their first use, since most stages read none.

    `recording` is the bag, which may be in place.
    """

    description: Path
    recording: Path | None
    is_in_place: bool = False
    opened: SweepSource | None = None

    def sweep(self, index: int) -> Sweep:
        if self.opened is None:
            if self.recording is None:
                raise ValueError("a stage that declares no sweeps reads a sweep")
            recording = self.recording
            sweeps = read_sweeps(self.description.read_bytes(), lambda _: recording)
            self.opened = replace(sweeps, is_in_place=self.is_in_place)
        return self.opened.sweep(index)


@dataclass(frozen=True)
class RunOpening:
    """The inputs for opening a run: its folder, choices, sequence file, grid, and the bag if sweeps are read."""

    folder: Path
    profile: str
    choices: Mapping[str, float]
    recording: Path | None = None
    is_in_place: bool = False
    sequence_file: str = SEQUENCE_FILE
    grid: LabelGrid = PAPER

    def run(self) -> LabelRun:
        path = self.folder / self.sequence_file
        status = path.stat()
        sequence = _sequence_of(path, (status.st_ino, status.st_mtime_ns, status.st_size))
        sweeps = LateSweeps(self.folder / SWEEPS_FILE, self.recording, self.is_in_place)
        return LabelRun(sequence, sweeps, chosen_parameters(self.profile, self.choices, (self.grid,)), self.folder)


@lru_cache(maxsize=1)
def _sequence_of(path: Path, _version: tuple[int, int, int]) -> Sequence:
    """Return a cached sequence: a child that is kept for a run reads it once, not for each job."""
    return read_sequence(path.read_bytes())


@dataclass(frozen=True)
class StageTask:
    """One job of a run: its kind and its arguments."""

    opening: RunOpening
    kind: str
    arguments: Mapping[str, Any]


def planned(opening: RunOpening, _folder: Path, _progress: ProgressCallback) -> bytes:
    """Return all jobs of the run. Raises `no_frames`, and as `label_graph`."""
    run = opening.run()
    if len(run.sequence.frames) == 0:
        raise no_usable_frames(run.sequence)
    jobs = label_graph(run)
    parts, tiles = (sum(job.kind == kind for job in jobs) for kind in (FUSE, SURFACE))
    return GraphAnswer(jobs=[_answer_of(job) for job in jobs], parts=parts, tiles=tiles).packed()


def _answer_of(job: JobSpec) -> JobAnswer:
    fields = {name: value for name, value in vars(job).items() if name != "after"}
    return JobAnswer(**fields)


def files_near(task: StageTask, _folder: Path, _progress: ProgressCallback) -> bytes:
    """Return the files that this job reads besides those of every job of its kind."""
    list_near = STAGES[task.kind].list_near
    return FilesAnswer(names=list_near(task.opening.run(), task.arguments) if list_near else ()).packed()


def worked(task: StageTask, _folder: Path, progress: ProgressCallback) -> bytes:
    """Do the job's work. Raises what the work raises."""
    stage, run = STAGES[task.kind], task.opening.run()
    with recorded_writes() as paths:
        done = stage.work(run, task.arguments, partial(progress, stage.step_name))
    written = tuple(path.relative_to(run.scratch).as_posix() for path in paths)
    return WorkAnswer(result=dict(done.result), facts=dict(done.facts), written=written).packed()


def described(opening: RunOpening, _folder: Path, _progress: ProgressCallback) -> bytes:
    """Write the report and the frame table, and return the facts for the run's rows."""
    return publication(opening.run()).packed()
