"""Routes of the caller's jobs: progress, logs, cancel."""

from dataclasses import dataclass
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Query
from sqlalchemy import Select, select

from api import audit
from api.answers import refusals
from api.callers import Curator, Reader
from api.deps import PlatformDep, at_once
from api.job_acts import control_run
from api.paging import Page, PageDep, page
from api.schemas.admin import CancelBody
from api.schemas.base import IdPath, IdQuery
from api.schemas.jobs import JobDetail, JobItem, LogPage
from api.views.jobs import job_detail, job_items
from api.views.log_pages import LogQuery, log_page
from api.visible import job_of
from services.runtime.orm import Job

router = APIRouter(prefix="/jobs", tags=["jobs"])
State = Literal["queued", "running", "succeeded", "failed", "cancelled"]
Kind = Annotated[str | None, Query(pattern=r"^[a-z][a-z_]*(\.[a-z][a-z_]*)*$", max_length=64)]
After = Annotated[str | None, Query(max_length=90, description="`next` of the page before")]
Lines = Annotated[int, Query(ge=1, le=1000)]


@dataclass(frozen=True)
class JobFilters:
    """Which jobs a list shows; without `root_id` runs and single jobs, with it the jobs of that run."""

    state: State | None = None
    kind: Kind = None
    sequence_id: IdQuery = None
    root_id: IdQuery = None

    def narrowed(self, statement: Select[Job]) -> Select[Job]:
        return self.one_level(self.equal(statement, ("state", "kind", "sequence_id", "root_id")))

    def equal(self, statement: Select[Job], keys: tuple[str, ...]) -> Select[Job]:
        """Rows whose columns equal the filters that are given."""
        asked = {key: value for key in keys if (value := getattr(self, key)) is not None}
        return statement.filter_by(**asked)

    def one_level(self, statement: Select[Job]) -> Select[Job]:
        return statement.where((Job.id == Job.root_id) if self.root_id is None else (Job.id != Job.root_id))


async def log_query(after: After = None, limit: Lines = 200) -> LogQuery:
    return LogQuery(after, limit)


@router.get("", responses=refusals(403))
def list_jobs(
    caller: Reader, platform: PlatformDep, query: PageDep, filters: Annotated[JobFilters, Depends(at_once(JobFilters))]
) -> Page[JobItem]:
    """The caller's own runs, newest first."""
    mine = select(Job).where(Job.owner_id == caller.user_id)
    with platform.database.reading() as session:
        found = page(session, filters.narrowed(mine), Job.id.desc(), query)
        return Page[JobItem](items=job_items(session, found.rows), next=found.next)


@router.get("/{job_id}", summary="A job of one's own and its progress", responses=refusals(403, 404))
def show_job(job_id: IdPath, caller: Reader, platform: PlatformDep) -> JobDetail:
    """How far a job is, and why it failed if it did."""
    with platform.database.reading() as session:
        return job_detail(session, job_of(session, caller, job_id))


@router.get("/{job_id}/logs", summary="The log of a job of one's own", responses=refusals(403, 404))
def read_logs(
    job_id: IdPath, caller: Reader, platform: PlatformDep, query: Annotated[LogQuery, Depends(log_query)]
) -> LogPage:
    """What a job, or every job of a run, has said so far."""
    with platform.database.reading() as session:
        return log_page(session, job_of(session, caller, job_id), query, is_administrator=caller.is_administrator)


@router.post("/{job_id}/cancel", status_code=202, responses=refusals(403, 404, 409))
def cancel_job(job_id: IdPath, caller: Curator, platform: PlatformDep, body: CancelBody | None = None) -> JobDetail:
    """Ask the whole run of a job to stop: what is queued will not start, what runs stops at its next step."""
    reason = body.reason if body else ""
    with platform.database.transaction() as session:
        root_id = job_of(session, caller, job_id).root_id
        run = control_run(session, platform, caller, "cancel", root_id, reason)
        audit.record(session, caller, "job.cancel", run.id, reason)
        session.flush()
        return job_detail(session, run)
