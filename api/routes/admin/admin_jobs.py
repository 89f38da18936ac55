"""Routes for administrators: jobs, queues and workers; every act is audited with its reason."""

from dataclasses import dataclass
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Path, Query
from sqlalchemy import Select, or_, select

from api import audit
from api.answers import refusals
from api.deps import Administrator, PlatformDep, at_once
from api.errors import NotFoundError
from api.job_acts import act_on_each, control_run
from api.lists.answers import JobFilters
from api.paging import Page, PageDep, page, whole
from api.routes.jobs import log_query
from api.schemas.admin import (
    AdminJobDetail,
    AdminJobItem,
    JobAct,
    JobActItem,
    JobActsBody,
    JobCounts,
    QueueItem,
    ReasonBody,
    WorkersAnswer,
)
from api.schemas.base import IdPath, IdQuery, LineQuery
from api.schemas.jobs import LogPage
from api.views.admin import (
    DEAD,
    admin_job_detail,
    admin_job_items,
    job_counts,
    pending_wake_ups_of,
    queue_items,
    running_items,
    worker_items,
)
from api.views.jobs import LogQuery, log_page
from api.visible import job_of
from services.runtime.jobs import control
from services.runtime.jobs.broker_app import QUEUES
from services.runtime.orm import Job, User

router = APIRouter(prefix="/admin", tags=["administration"])
QueueName = Annotated[str, Path(pattern=r"^[a-z]{1,16}$", examples=["labeler"])]
QueueAct = Literal["pause", "drain", "resume"]
MODE_AFTER = {"pause": "paused", "drain": "draining", "resume": "open"}
IdPart = Annotated[str | None, Query(pattern="^[0-9a-f]{4,32}$", description="Start or end of the id.")]


@dataclass(frozen=True)
class AdminFilters(JobFilters):
    """As `JobFilters`, also by owner, queue and a piece of the id; the jobs of a queue are listed one by one.

    `dead` are the single jobs that failed with no attempt left, within runs or not.
    """

    queue: Literal["ingest", "labeler", "eval", "notify"] | None = None
    owner_id: IdQuery = None
    owner: LineQuery = None
    id_part: IdPart = None
    dead: bool = False

    def narrowed(self, statement: Select[Job]) -> Select[Job]:
        statement = self.equal(self.flat(statement), ("state",))
        return statement.where(DEAD) if self.dead else self.levelled(statement)

    def of_any_state(self, statement: Select[Job]) -> Select[Job]:
        return self.levelled(self.flat(statement))

    def flat(self, statement: Select[Job]) -> Select[Job]:
        """Select jobs in any state, including the jobs within runs."""
        statement = self.equal(statement, ("kind", "sequence_id", "root_id", "queue", "owner_id"))
        if self.owner is not None:
            statement = statement.where(Job.owner_id.in_(select(User.id).where(User.name == self.owner)))
        if self.id_part is not None:
            statement = statement.where(or_(Job.id.startswith(self.id_part), Job.id.endswith(self.id_part)))
        return statement

    def levelled(self, statement: Select[Job]) -> Select[Job]:
        """Select runs and single jobs; with an id or a queue, select jobs within runs too."""
        return statement if self.queue or self.id_part else self.one_level(statement)


AdminFiltersDep = Annotated[AdminFilters, Depends(at_once(AdminFilters))]


@router.get("/jobs", responses=refusals(403))
def list_all_jobs(
    _caller: Administrator, platform: PlatformDep, query: PageDep, filters: AdminFiltersDep
) -> Page[AdminJobItem]:
    """List all users' jobs, newest first."""
    with platform.database.reading() as session:
        jobs = page(session, filters.narrowed(select(Job)), Job.id.desc(), query)
        return Page[AdminJobItem](items=admin_job_items(session, jobs.rows), next=jobs.next)


@router.get("/jobs/counts", summary="Count the jobs in each state", responses=refusals(403))
def count_jobs(_caller: Administrator, platform: PlatformDep, filters: AdminFiltersDep) -> JobCounts:
    """Count the jobs. The filters `state` and `dead` have no effect here."""
    with platform.database.reading() as session:
        return job_counts(session, filters.of_any_state(select(Job)), filters.flat(select(Job)))


@router.post("/jobs/acts", summary="Cancel, terminate or retry many runs", responses=refusals(403))
def steer_jobs(body: JobActsBody, caller: Administrator, platform: PlatformDep) -> Page[JobActItem]:
    """Apply one act to the runs of many jobs. Each run is changed or refused on its own, with its own result."""
    return whole(act_on_each(platform, caller, body))


@router.get("/jobs/{job_id}", summary="Show a job of any user", responses=refusals(403, 404))
def show_any_job(job_id: IdPath, caller: Administrator, platform: PlatformDep) -> AdminJobDetail:
    """Return its progress; for a run also its jobs, unsuccessful jobs first."""
    with platform.database.reading() as session:
        return admin_job_detail(session, job_of(session, caller, job_id))


@router.get("/jobs/{job_id}/logs", summary="Show the log of any job", responses=refusals(403, 404))
def list_any_job_log(
    job_id: IdPath, caller: Administrator, platform: PlatformDep, query: Annotated[LogQuery, Depends(log_query)]
) -> LogPage:
    """Return the log lines of a job, or of all jobs of a run."""
    with platform.database.reading() as session:
        return log_page(session, job_of(session, caller, job_id), query, is_administrator=caller.is_administrator)


@router.post(
    "/jobs/{job_id}/{act}",
    summary="Cancel, terminate or retry a run",
    status_code=202,
    responses=refusals(403, 404, 409),
)
def steer_job(
    job_id: IdPath, act: JobAct, body: ReasonBody, caller: Administrator, platform: PlatformDep
) -> AdminJobDetail:
    """Apply the act: `cancel` stops it at its next step, `terminate` stops its processes, `retry` queues it again."""
    with platform.database.transaction() as session:
        root_id = job_of(session, caller, job_id).root_id
        run = control_run(session, platform, caller, act, root_id, body.reason)
        audit.record_admin_act(session, caller, f"job.{act}", root_id, body.reason)
        session.flush()
        return admin_job_detail(session, run)


@router.get(
    "/queues",
    summary="List the queues with mode, job counts and unacknowledged broker notifications",
    responses=refusals(403),
)
def list_queues(_caller: Administrator, platform: PlatformDep) -> Page[QueueItem]:
    """List the queues with mode, job counts and unacknowledged broker notifications."""
    wake_ups = pending_wake_ups_of(platform)
    with platform.database.reading() as session:
        return whole(queue_items(session, wake_ups))


@router.post("/queues/{queue}/{act}", summary="Pause, drain or resume a queue", responses=refusals(403, 404))
def switch_queue(
    queue: QueueName, act: QueueAct, body: ReasonBody, caller: Administrator, platform: PlatformDep
) -> QueueItem:
    """Switch the queue. `pause`: no job starts. `drain`: queued jobs run, no job is added. `resume`: normal
    operation.
    """
    if queue not in QUEUES:
        raise NotFoundError("queue", queue)
    with platform.database.transaction() as session:
        control.set_mode(session, queue, MODE_AFTER[act])
        audit.record_admin_act(session, caller, f"queue.{act}", queue, body.reason)
    wake_ups = pending_wake_ups_of(platform)
    with platform.database.reading() as session:
        return queue_items(session, wake_ups)[QUEUES.index(queue)]


@router.get("/workers", summary="List the workers and their jobs", responses=refusals(403))
def list_workers(_caller: Administrator, platform: PlatformDep) -> WorkersAnswer:
    """Return the workers in the database, and the availability of the broker."""
    is_reachable = all(count is not None for count in pending_wake_ups_of(platform).values())
    with platform.database.reading() as session:
        workers, running = worker_items(session, platform.settings), running_items(session)
    return WorkersAnswer(workers=workers, running=running, is_broker_reachable=is_reachable)
