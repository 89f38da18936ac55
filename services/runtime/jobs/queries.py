"""Progress of jobs for people and pages: stages with counts and times.

`services/domain/runs` estimates the remaining time of a run.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from sqlalchemy import BigInteger, ColumnElement, Select, case, cast, func, select
from sqlalchemy.orm import Session

from services.runtime.orm import Job


@dataclass(frozen=True)
class StageProgress:
    """Jobs of one kind in a run: the numbers of all, succeeded, failed and running jobs.

    `began_ns` is the first start, `ended_ns` the last end; `busy_ns` is the total time of the succeeded jobs.
    """

    kind: str
    total: int
    done: int
    running: int
    failed: int
    began_ns: int | None = None
    ended_ns: int | None = None
    busy_ns: int = 0


@dataclass(frozen=True)
class Progress:
    """`done` of `total` in units of the job (or jobs of the run); `rate_per_s` of a running single job, else None."""

    stage: str
    done: int
    total: int
    rate_per_s: float | None = None
    stages: tuple[StageProgress, ...] = ()


def progress_of(session: Session, job: Job) -> Progress:
    """Return a job's own progress; for a run, the progress of its jobs."""
    if job.queue:
        return Progress(job.stage, job.done, job.total, _rate_per_s(job))
    stages = tuple(StageProgress(*row) for row in session.execute(_stages(job.id)))
    active = next((stage.kind for stage in reversed(stages) if stage.running), "")
    return Progress(active, sum(s.done for s in stages), sum(s.total for s in stages), None, stages)


def _rate_per_s(job: Job) -> float | None:
    """Return the units per second since its start, by its last report."""
    if job.state != "running" or not job.started_ns or not job.done:
        return None
    until_ns = job.progress_ns or 0
    return job.done / (until_ns - job.started_ns) * 1e9 if until_ns > job.started_ns else None


def _stages(root_id: str) -> Select[str, int, int, int, int, int | None, int | None, int]:
    def counted(state: str) -> ColumnElement[int]:
        return func.sum(case((Job.state == state, 1), else_=0))

    lasted = func.sum(case((Job.state == "succeeded", func.coalesce(Job.finished_ns - Job.started_ns, 0)), else_=0))
    spans = (func.min(Job.started_ns), func.max(Job.finished_ns), cast(lasted, BigInteger))
    return (
        select(Job.kind, func.count(), counted("succeeded"), counted("running"), counted("failed"), *spans)
        .where(Job.root_id == root_id, Job.queue != "")
        .group_by(Job.kind)
        .order_by(func.min(Job.id))
    )


# Titles of runs and jobs for people, by kind, in the imperative and in the terms of the glossary. Stages of one run are
# in the order in which they start. The title of other kinds is the kind.


TITLES: Mapping[str, str] = {
    "sequence.process": "Label the sequence",
    "ingest.register": "Read the recording",
    "ingest.synchronise": "Synchronise sensors",
    "ingest.check": "Check cameras and clocks",
    "labeler.parts": "Plan the map",
    "labeler.fuse": "Fuse sweeps",
    "labeler.surface": "Reconstruct the surface",
    "labeler.reference": "Fit the reference terrain model",
    "labeler.frames": "Label frames",
    "labeler.map": "Render the map",
    "labeler.pictures": "Draw pictures of the map",
    "labeler.publish": "Publish the labels",
    "labeler.export": "Export the labels",
    "eval.compare": "Compare label sets",
    "dataset.import": "Import the dataset",
    "ingest.keep_dataset": "Store the dataset",
    "labeler.import_index": "Read the dataset's tables",
    "labeler.import_scene": "Import scenes",
    "labeler.import_publish": "Publish the dataset",
    "dataset.inputs": "Create inputs of the dataset version",
    "phase.inputs": "Create inputs of the phase",
    "labeler.inputs": "Write inputs",
    "score": "Score the submission",
    "phase.rescore": "Re-score the phase",
    "eval.open": "Validate the file",
    "eval.part": "Count voxels",
    "eval.join": "Compute scores",
    "eval.truth": "Build the ground truth",
    "notify.deliver": "Deliver the notification",
}


def title_of(kind: str) -> str:
    """Return the title of jobs of this kind."""
    return TITLES.get(kind, kind)
