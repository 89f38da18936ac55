"""Routes of the caller's jobs: progress, logs, cancel."""

from typing import Annotated

from fastapi import APIRouter, Depends, Query, Request, Response

from api import audit
from api.answers import refusals
from api.deps import Curator, PlatformDep, Reader, at_once
from api.job_acts import control_run
from api.lists.answers import JobFilters, job_rows, list_response, listed
from api.paging import Page, PageDep
from api.row_readers import by_row_readers
from api.schemas.admin import CancelBody
from api.schemas.base import IdPath
from api.schemas.jobs import JobDetail, JobItem, LogPage
from api.views.jobs import LogQuery, facts_of_rows, job_detail, log_page
from api.visible import job_of

router = APIRouter(prefix="/jobs", tags=["jobs"])
After = Annotated[str | None, Query(max_length=90, description="`next` of the previous page.")]
Lines = Annotated[int, Query(ge=1, le=1000)]


async def log_query(after: After = None, limit: Lines = 200) -> LogQuery:
    return LogQuery(after, limit)


@router.get("", response_model=Page[JobItem], responses=listed(403))
@by_row_readers
def list_jobs(
    request: Request,
    caller: Reader,
    platform: PlatformDep,
    query: PageDep,
    filters: Annotated[JobFilters, Depends(at_once(JobFilters))],
) -> Response:
    """List your runs, newest first."""
    with platform.database.lookups() as session:
        rows, following = job_rows(session, caller.user_id, filters, query)
        return list_response(request, facts_of_rows(session, rows), following)


@router.get("/{job_id}", summary="Show one of your jobs", responses=refusals(403, 404))
def show_job(job_id: IdPath, caller: Reader, platform: PlatformDep) -> JobDetail:
    """Return its progress, and the reason if it failed."""
    with platform.database.reading() as session:
        return job_detail(session, job_of(session, caller, job_id))


@router.get("/{job_id}/logs", summary="Show the log of one of your jobs", responses=refusals(403, 404))
def list_job_log(
    job_id: IdPath, caller: Reader, platform: PlatformDep, query: Annotated[LogQuery, Depends(log_query)]
) -> LogPage:
    """Return the log lines of a job, or of all jobs of a run."""
    with platform.database.reading() as session:
        return log_page(session, job_of(session, caller, job_id), query, is_administrator=caller.is_administrator)


@router.post("/{job_id}/cancel", status_code=202, responses=refusals(403, 404, 409))
def cancel_job(job_id: IdPath, caller: Curator, platform: PlatformDep, body: CancelBody | None = None) -> JobDetail:
    """Cancel the whole run of a job: queued jobs do not start, and running jobs stop at their next step."""
    reason = body.reason if body else ""
    with platform.database.transaction() as session:
        root_id = job_of(session, caller, job_id).root_id
        run = control_run(session, platform, caller, "cancel", root_id, reason)
        audit.record(session, caller, "job.cancel", run.id, reason)
        session.flush()
        return job_detail(session, run)
