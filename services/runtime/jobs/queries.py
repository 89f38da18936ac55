"""Progress of jobs for people and pages: stages with counts, rate and time left."""

from dataclasses import dataclass

from sqlalchemy import ColumnElement, Select, case, func, select
from sqlalchemy.orm import Session

from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import Job
from services.runtime.orm.base import now_ns


@dataclass(frozen=True)
class StageProgress:
    """Jobs of one kind in a run: how many there are, how many succeeded, failed and are running."""

    kind: str
    total: int
    done: int
    running: int
    failed: int


@dataclass(frozen=True)
class Progress:
    """`done` of `total` in units of the job (or jobs of the run), per second, and seconds left (None: unknown)."""

    stage: str
    done: int
    total: int
    rate_per_s: float | None
    eta_s: float | None
    stages: tuple[StageProgress, ...]


def progress_of(session: Session, job: Job) -> Progress:
    """A job's own progress; of a run, that of its jobs."""
    if job.queue:
        return rated(job, job.stage, job.done, job.total, ())
    stages = tuple(StageProgress(*row) for row in session.execute(_stages(job.id)))
    active = next((stage.kind for stage in reversed(stages) if stage.running), "")
    return rated(job, active, sum(s.done for s in stages), sum(s.total for s in stages), stages)


def _stages(root_id: str) -> Select[str, int, int, int, int]:
    def counted(state: str) -> ColumnElement[int]:
        return func.sum(case((Job.state == state, 1), else_=0))

    return (
        select(Job.kind, func.count(), counted("succeeded"), counted("running"), counted("failed"))
        .where(Job.root_id == root_id, Job.queue != "")
        .group_by(Job.kind)
        .order_by(func.min(Job.id))
    )


def rated(job: Job, stage: str, done: int, total: int, stages: tuple[StageProgress, ...] = ()) -> Progress:
    """The progress with its rate since the job began, as long as it runs."""
    if not job.started_ns or not done or job.state in TERMINAL:
        return Progress(stage, done, total, None, None, stages)
    passed_s = max((job.progress_ns or now_ns()) - job.started_ns, 1) / 1e9
    rate = done / passed_s
    return Progress(stage, done, total, rate, max(total - done, 0) / rate, stages)
