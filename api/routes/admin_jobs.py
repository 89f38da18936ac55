"""The administrator's hand on jobs, queues and workers; each act says why and is in the audit log."""

from dataclasses import dataclass
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Path
from redis import RedisError
from sqlalchemy import ColumnElement, Select, and_, case, func, select
from sqlalchemy.orm import Session

from api import audit
from api.answers import refusals
from api.callers import Administrator
from api.deps import PlatformDep, at_once
from api.errors import NotFoundError
from api.job_views import job_detail, job_items
from api.log_pages import LogQuery, log_page
from api.paging import Page, PageDep, page
from api.routes.jobs import JobFilters, log_query
from api.schemas.admin import AdminJobDetail, QueueItem, ReasonBody, RunningAttempt, WorkersAnswer
from api.schemas.base import IdPath, IdQuery
from api.schemas.jobs import JobItem, LogPage
from api.visible import job_of
from services.runtime.bell import waiting
from services.runtime.benchmarks.submission_states import reopen
from services.runtime.celery_app import QUEUES
from services.runtime.jobs import steering
from services.runtime.orm import Job, Queue
from services.runtime.platform import Platform
from services.runtime.workers import BrokerAwayError, node_calls, running_attempts

router = APIRouter(prefix="/admin", tags=["administration"])
QueueName = Annotated[str, Path(pattern=r"^[a-z]{1,16}$", examples=["labeler"])]
JobAct = Literal["retry", "cancel", "terminate"]
QueueAct = Literal["pause", "drain", "resume"]
MODE_AFTER = {"pause": "paused", "drain": "draining", "resume": "open"}
MOST_CHILDREN = 200
MOST_ATTEMPTS = 500


@dataclass(frozen=True)
class AdminFilters(JobFilters):
    """As `JobFilters`, also by owner and queue; the jobs of a queue are listed one by one."""

    queue: Literal["ingest", "labeler", "eval"] | None = None
    owner_id: IdQuery = None

    def narrowed(self, statement: Select[Job]) -> Select[Job]:
        statement = self.equal(statement, ("state", "kind", "sequence_id", "root_id", "queue", "owner_id"))
        return statement if self.queue else self.one_level(statement)


@router.get("/jobs", responses=refusals(403))
def list_all_jobs(
    _caller: Administrator,
    platform: PlatformDep,
    query: PageDep,
    filters: Annotated[AdminFilters, Depends(at_once(AdminFilters))],
) -> Page[JobItem]:
    """Everybody's jobs, newest first."""
    with platform.database.reading() as session:
        found = page(session, filters.narrowed(select(Job)), Job.id.desc(), query)
        return Page[JobItem](items=job_items(session, found.rows), next=found.next)


@router.get("/jobs/{job_id}", responses=refusals(403, 404))
def show_any_job(job_id: IdPath, caller: Administrator, platform: PlatformDep) -> AdminJobDetail:
    """A job; of a run also its jobs, those that have not succeeded first."""
    with platform.database.reading() as session:
        return _detail(session, job_of(session, caller, job_id))


@router.get("/jobs/{job_id}/logs", responses=refusals(403, 404))
def read_any_logs(
    job_id: IdPath, caller: Administrator, platform: PlatformDep, query: Annotated[LogQuery, Depends(log_query)]
) -> LogPage:
    """What a job, or every job of a run, has said so far."""
    with platform.database.reading() as session:
        return log_page(session, job_of(session, caller, job_id), query, is_administrator=caller.is_administrator)


@router.post("/jobs/{job_id}/{act}", status_code=202, responses=refusals(403, 404, 409))
def steer_job(
    job_id: IdPath, act: JobAct, body: ReasonBody, caller: Administrator, platform: PlatformDep
) -> AdminJobDetail:
    """Steer the whole run of a job: `cancel` asks it to stop, `terminate` stops its processes, `retry` queues again."""
    with platform.database.transaction() as session:
        root_id = job_of(session, caller, job_id).root_id
        run = _steered(session, platform, act, root_id, body.reason)
        audit.record_admin_act(session, caller, f"job.{act}", root_id, body.reason)
        session.flush()
        return _detail(session, run)


@router.get("/queues", responses=refusals(403))
def list_queues(_caller: Administrator, platform: PlatformDep) -> list[QueueItem]:
    """Each queue with its switch, its jobs and the bells that nobody has heard yet."""
    bells = _bells(platform)
    with platform.database.reading() as session:
        return [_queue(session, name, bells[name]) for name in QUEUES]


@router.post("/queues/{queue}/{act}", responses=refusals(403, 404))
def switch_queue(
    queue: QueueName, act: QueueAct, body: ReasonBody, caller: Administrator, platform: PlatformDep
) -> QueueItem:
    """`pause`: nothing new starts. `drain`: what is queued runs, nothing is added. `resume`: open again."""
    if queue not in QUEUES:
        raise NotFoundError("queue", queue)
    with platform.database.transaction() as session:
        steering.set_mode(session, queue, MODE_AFTER[act])
        audit.record_admin_act(session, caller, f"queue.{act}", queue, body.reason)
    bells = _bells(platform)
    with platform.database.reading() as session:
        return _queue(session, queue, bells[queue])


@router.get("/workers", responses=refusals(403))
def list_workers(_caller: Administrator, platform: PlatformDep) -> WorkersAnswer:
    """What runs now, by the database; who answers a call, by the broker, if that answers."""
    with platform.database.reading() as session:
        running = [
            RunningAttempt(job_id=job.id, kind=job.kind, attempt=attempt.number, worker=attempt.worker)
            for job, attempt in running_attempts(session, MOST_ATTEMPTS)
        ]
    try:
        nodes, is_reachable = node_calls(platform.settings)(), True
    except BrokerAwayError:
        nodes, is_reachable = [], False
    return WorkersAnswer(running=running, nodes=nodes, is_broker_reachable=is_reachable)


def _steered(session: Session, platform: Platform, act: JobAct, root_id: str, reason: str) -> Job:
    if act == "retry":
        run = steering.retry(session, root_id, platform.settings.jobs.max_attempts)
        reopen(session, run)
        return run
    return (steering.cancel if act == "cancel" else steering.terminate)(session, root_id, reason)


def _detail(session: Session, job: Job) -> AdminJobDetail:
    children = (Job.root_id == job.id, Job.id != job.id)
    unfinished_first = case((Job.state == "succeeded", 1), else_=0)
    shown = select(Job).where(*children).order_by(unfinished_first, Job.id).limit(MOST_CHILDREN)
    return AdminJobDetail(
        **dict(job_detail(session, job)),
        children=job_items(session, session.scalars(shown).all()),
        children_total=session.scalar(select(func.count()).select_from(Job).where(*children)) or 0,
    )


def _bells(platform: Platform) -> dict[str, int | None]:
    """Bells not yet heard, by queue; None where the broker does not answer."""
    count = waiting(platform.settings)
    try:
        return {name: count(name) for name in QUEUES}
    except (RedisError, OSError):
        return dict.fromkeys(QUEUES)


def _queue(session: Session, name: str, bells: int | None) -> QueueItem:
    def counted(*claims: ColumnElement[bool]) -> ColumnElement[int]:
        return func.coalesce(func.sum(case((and_(*claims), 1), else_=0)), 0)

    queued = Job.state == "queued"
    counts = select(
        counted(queued, Job.needs_left == 0), counted(queued, Job.needs_left > 0), counted(Job.state == "running")
    ).where(Job.queue == name, Job.state.in_(("queued", "running")))
    ready, blocked, running = session.execute(counts).one()
    mode = session.scalar(select(Queue.mode).where(Queue.name == name)) or "open"
    return QueueItem(name=name, mode=mode, ready=ready, waiting=blocked, running=running, bells=bells)
