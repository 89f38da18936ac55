"""Finds the next ready job of a queue by index, however many jobs wait.

**Conventions.** First the owners who have a ready job, hopped to one after another, each with the urgency of its most
urgent job and how many of its jobs run; then the oldest job of the first of them that nobody else is just taking
(`SKIP LOCKED` on PostgreSQL; SQLite has one writer at a time). Of equal urgency the job of the older run goes first, so
that runs are finished before others are begun. Predicates of partial indexes are literals (`orm/jobs.py`).
"""

from functools import lru_cache

from sqlalchemy import ColumnElement, Select, and_, bindparam, func, literal_column, select
from sqlalchemy.orm import Session, aliased
from sqlalchemy.sql.selectable import CTE

from services.runtime.database.rows import KeptSelect
from services.runtime.orm import Job

MOST_WAKE_UPS = 10_000
"""More wake-ups than this for one queue wake nobody: the sweeper sends others as they are received."""
MOST_QUEUES = 64
"""Statements are kept for so many queues: one takes longer to write than to run."""
QUEUED: ColumnElement[str] = literal_column("'queued'")
RUNNING: ColumnElement[str] = literal_column("'running'")
NONE: ColumnElement[int] = literal_column("0")


def next_job(session: Session, queue: str) -> tuple[Job, str] | None:
    """The job of `queue` to be taken next, its row locked, and the state of its run (its own where it is one).

    None where each that is ready is being taken.
    """
    session.flush()  # kept statements see what was written, not what is to be
    owners = owners_waiting(queue).rows(session, {})
    for owner_id, priority, _running, _oldest in owners:
        found = session.execute(_untaken_of_owner(queue), {"owner": owner_id, "urgency": priority}).first()
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


@lru_cache(MOST_QUEUES)
def _untaken_of_owner(queue: str) -> Select[Job, str]:
    """The oldest run's of the jobs of `owner` with `urgency`."""
    of_owner = (Job.owner_id == bindparam("owner"), Job.priority == bindparam("urgency"))
    return _untaken(queue, *of_owner).order_by(Job.root_id, Job.id)


def _untaken(queue: str, *claims: ColumnElement[bool]) -> Select[Job, str]:
    run = aliased(Job)
    state_of_run = select(run.state).where(run.id == Job.root_id).correlate(Job).scalar_subquery()
    free = select(Job, state_of_run).where(_is_ready(Job, queue), *claims).limit(1)
    return free.with_for_update(skip_locked=True, key_share=True).execution_options(populate_existing=True)


@lru_cache(MOST_QUEUES)
def owners_waiting(queue: str) -> KeptSelect:
    """Of (owner, urgency, running jobs, oldest run) of every owner with a ready job: whose turn it is comes first."""
    heads, busy = _heads(queue).c, aliased(Job)
    at_work = select(func.count()).where(busy.queue == queue, busy.state == RUNNING, busy.owner_id == heads.owner_id)
    running = at_work.scalar_subquery().label("running")
    found = select(heads.owner_id, heads.priority, running, heads.root_id)
    return KeptSelect(found.order_by(heads.priority.desc(), running, heads.root_id))


def _heads(queue: str) -> CTE:
    """The first ready job of every owner, its most urgent and of these the oldest run's; one step down the index each.

    The order names every column of that index: by the smallest run alone, PostgreSQL walks all runs that ever were.
    """
    first, following = aliased(Job), aliased(Job)
    begin = select(first.owner_id, first.priority, first.root_id).where(first.id == _head(queue).scalar_subquery())
    heads = begin.cte(recursive=True)
    after = _head(queue, heads).correlate(heads).scalar_subquery()
    of_next = select(following.owner_id, following.priority, following.root_id)
    return heads.union_all(of_next.join_from(heads, following, following.id == after))


def _head(queue: str, after: CTE | None = None) -> Select[str]:
    """The id of the first ready job of the owner who follows those of `after`."""
    job = aliased(Job)
    ready = select(job.id).where(_is_ready(job, queue))
    if after is not None:
        ready = ready.where(job.owner_id > after.c.owner_id)
    return ready.order_by(job.owner_id, job.priority.desc(), job.root_id, job.id).limit(literal_column("1"))
