"""Finds the next ready job of a queue by index, however many jobs wait.

**Conventions.** First the owners who have a ready job, hopped to one after another, each with the urgency of its most
urgent job and how many of its jobs run; then the oldest job of the first of them that nobody else is just taking
(`SKIP LOCKED` on PostgreSQL; SQLite has one writer at a time). Of equal urgency the job of the older run goes first, so
that runs are finished before others are begun. Predicates of partial indexes are literals (`orm/jobs.py`).
"""

from sqlalchemy import ColumnElement, Select, and_, func, literal_column, select
from sqlalchemy.orm import Session, aliased
from sqlalchemy.sql.selectable import CTE

from services.runtime.orm import Job

MOST_WAKE_UPS = 10_000
"""More wake-ups than this for one queue wake nobody: the sweeper sends others as they are received."""
QUEUED: ColumnElement[str] = literal_column("'queued'")
RUNNING: ColumnElement[str] = literal_column("'running'")
NONE: ColumnElement[int] = literal_column("0")


def next_job(session: Session, queue: str) -> tuple[Job, str] | None:
    """The job of `queue` to be taken next, its row locked, and the state of its run (its own where it is one).

    None where each that is ready is being taken.
    """
    owners = session.execute(owners_waiting(queue)).all()
    for owner_id, priority, _running, _oldest in owners:
        of_owner = (Job.owner_id == owner_id, Job.priority == priority)
        found = session.execute(_untaken(queue, *of_owner).order_by(Job.root_id, Job.id)).first()
        if found is not None:
            return found[0], found[1]
    found = session.execute(_untaken(queue)).first() if owners else None
    return None if found is None else (found[0], found[1])


def wake_ups_wanted(session: Session, queue: str) -> int:
    """The number of ready jobs of `queue`, at most `MOST_WAKE_UPS`."""
    some = select(literal_column("1")).select_from(Job).where(_is_ready(Job, queue)).limit(MOST_WAKE_UPS).subquery()
    return session.scalar(select(func.count()).select_from(some)) or 0


def _is_ready(job: type[Job], queue: str) -> ColumnElement[bool]:
    return and_(job.queue == queue, job.state == QUEUED, job.needs_left == NONE)


def _untaken(queue: str, *claims: ColumnElement[bool]) -> Select[Job, str]:
    run = aliased(Job)
    state_of_run = select(run.state).where(run.id == Job.root_id).correlate(Job).scalar_subquery()
    free = select(Job, state_of_run).where(_is_ready(Job, queue), *claims).limit(1)
    return free.with_for_update(skip_locked=True, key_share=True).execution_options(populate_existing=True)


def owners_waiting(queue: str) -> Select[str, int, int, str]:
    """(owner, urgency, running jobs, oldest run) of every owner with a ready job: whose turn it is comes first."""
    heads = _hopped(queue)
    urgent, busy = aliased(Job), aliased(Job)
    highest = select(func.max(urgent.priority)).where(_is_ready(urgent, queue), urgent.owner_id == heads.c.owner_id)
    urgency = highest.correlate(heads).scalar_subquery()
    running = select(func.count()).where(busy.queue == queue, busy.state == RUNNING, busy.owner_id == heads.c.owner_id)
    counted = running.correlate(heads).scalar_subquery()
    waiting = select(heads.c.owner_id, urgency.label("urgency"), counted.label("running"))
    of_owners = waiting.where(heads.c.owner_id.is_not(None)).subquery()
    oldest_job = aliased(Job)
    oldest = select(func.min(oldest_job.root_id)).where(
        _is_ready(oldest_job, queue),
        oldest_job.owner_id == of_owners.c.owner_id,
        oldest_job.priority == of_owners.c.urgency,
    )
    age = oldest.correlate(of_owners).scalar_subquery().label("age")
    return select(of_owners, age).order_by(of_owners.c.urgency.desc(), of_owners.c.running, age)


def _hopped(queue: str) -> CTE:
    """Owners with a ready job, each found as the smallest after the last: one step down the index each, then null."""
    first, following = aliased(Job), aliased(Job)
    heads = select(func.min(first.owner_id).label("owner_id")).where(_is_ready(first, queue)).cte(recursive=True)
    after = select(func.min(following.owner_id)).where(
        _is_ready(following, queue), following.owner_id > heads.c.owner_id
    )
    return heads.union_all(select(after.correlate(heads).scalar_subquery()).where(heads.c.owner_id.is_not(None)))
