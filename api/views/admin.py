"""Jobs as their administrator sees them: with names, counted by state, and a run's jobs along time."""

from collections.abc import Mapping
from collections.abc import Sequence as Listing
from dataclasses import dataclass

from sqlalchemy import Select, and_, case, func, select
from sqlalchemy.orm import InstrumentedAttribute, Session

from api.schemas.admin import AdminJobDetail, AdminJobItem, JobCounts
from api.views.jobs import job_detail, job_items
from services.runtime.orm import Job, SequenceRow, User

MOST_CHILDREN = 200
MOST_SPANS = 2000
LOOKED_AT = 1000
NEVER_NS = 2**62
DEAD = and_(Job.queue != "", Job.state == "failed", Job.attempts_left <= 0)
"""Jobs that failed after all their attempts; what refuses its input fails at once, and would again."""


@dataclass(frozen=True)
class JobSpan:
    """When a job of a run was worked on; `finished_ns` is None while it is not over."""

    job_id: str
    kind: str
    state: str
    attempt: int
    created_ns: int
    started_ns: int | None
    finished_ns: int | None


def admin_job_items(session: Session, jobs: Listing[Job]) -> list[AdminJobItem]:
    """Jobs as the administrator's list shows them; names are two statements for all."""
    owners = _names(session, User.id, User.name, {job.owner_id for job in jobs})
    sequences = _names(session, SequenceRow.id, SequenceRow.name, {job.sequence_id for job in jobs if job.sequence_id})
    return [
        AdminJobItem(
            **dict(item),
            owner=owners.get(job.owner_id, ""),
            sequence=sequences.get(job.sequence_id or ""),
            attempts_left=job.attempts_left if job.queue else 0,
        )
        for job, item in zip(jobs, job_items(session, jobs), strict=True)
    ]


def admin_job_detail(session: Session, job: Job) -> AdminJobDetail:
    """A job with its attempts; of a run also its jobs: those that have not succeeded first, then as they began."""
    children = (Job.root_id == job.id, Job.id != job.id)
    unfinished_first = case((Job.state == "succeeded", 1), else_=0)
    in_time = (unfinished_first, func.coalesce(Job.started_ns, NEVER_NS), Job.id)
    shown = select(Job).where(*children).order_by(*in_time).limit(MOST_CHILDREN)
    sequences = _names(session, SequenceRow.id, SequenceRow.name, {job.sequence_id} if job.sequence_id else set())
    return AdminJobDetail(
        **dict(job_detail(session, job)),
        owner=session.get_one(User, job.owner_id).name,
        sequence=sequences.get(job.sequence_id or ""),
        children=job_items(session, session.scalars(shown).all()),
        children_total=session.scalar(select(func.count()).select_from(Job).where(*children)) or 0,
    )


def job_counts(session: Session, levelled: Select[Job], flat: Select[Job]) -> JobCounts:
    """Numbers of jobs by state, of those that a list may show.

    `levelled` are the jobs of the list whatever their state, `flat` the same ones and those within runs.
    """
    by_state = levelled.with_only_columns(Job.state, func.count()).group_by(Job.state)
    counts = {state: count for state, count in session.execute(by_state)}
    dead = session.scalar(flat.with_only_columns(func.count()).where(DEAD)) or 0
    return JobCounts(**counts, dead=dead)


def late_kinds(session: Session) -> list[str]:
    """The kinds among the newest jobs, by name: what a filter suggests."""
    newest = select(Job.kind).order_by(Job.id.desc()).limit(LOOKED_AT).subquery()
    return sorted(session.scalars(select(newest.c.kind).distinct()))


def job_spans_of(session: Session, job: Job) -> list[JobSpan]:
    """The jobs of a run in the order they were made; of a single job, itself."""
    columns = (Job.id, Job.kind, Job.state, Job.attempt, Job.created_ns, Job.started_ns, Job.finished_ns)
    found = select(*columns).where(Job.root_id == job.id, Job.queue != "").order_by(Job.id).limit(MOST_SPANS)
    return [JobSpan(*row) for row in session.execute(found)]


def _names(
    session: Session, key: InstrumentedAttribute[str], name: InstrumentedAttribute[str], ids: set[str]
) -> Mapping[str, str]:
    return dict(session.execute(select(key, name).where(key.in_(ids))).all()) if ids else {}
