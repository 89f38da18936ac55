"""The administrator's view of the work: queues, workers and all users' jobs, at `/admin/jobs`."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta, tzinfo
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import HTMLResponse
from sqlalchemy import Select, select
from sqlalchemy.orm import Session

from api.deps import Administrator, PlatformDep, at_once
from api.paging import LONGEST_CURSOR, PageQuery, PageRows
from api.paging import page as page_of
from api.routes.admin.admin_jobs import AdminFilters
from api.schemas.base import PLAIN, IdPath, instant, instant_or_none
from api.views.admin import (
    admin_job_detail,
    admin_job_items,
    job_counts,
    job_spans_of,
    late_kinds,
    pending_wake_ups_of,
    queue_items,
    worker_items,
)
from api.views.jobs import job_items
from api.visible import job_of
from services.domain.notifications.spread import QUEUE as NOTIFY
from services.runtime.jobs.broker_app import QUEUES
from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import Job, SubmissionRow
from services.runtime.orm.base import now_ns
from services.runtime.sandbox.fences import missing_fences
from services.runtime.store.faults import noted_faults, scrub_status
from web.boards.slopes import bars
from web.rendering import page
from web.stage_picture import stage_picture
from web.zones import zone_of

router = APIRouter()
SHOWN = 50
DAY = r"^((19|20)\d\d-(0[1-9]|1[0-2])-(0[1-9]|[12]\d|3[01]))?$"
OF_THE_PAGE = ("list", "since", "until", "order", "cursor")
SPARK = (120.0, 28.0)
LISTS = (
    ("", "All"),
    ("queued", "Queued"),
    ("running", "Running"),
    ("succeeded", "Succeeded"),
    ("failed", "Failed"),
    ("cancelled", "Cancelled"),
    ("dead", "Dead letters"),
)
"""The lists by state: word of the address, and of the page."""


@dataclass(frozen=True)
class JobSearch:
    """The fields of the page's search form; empty is anything. `list` is one of `LISTS`."""

    list: Annotated[str, Query(pattern=r"^(queued|running|succeeded|failed|cancelled|dead)?$")] = ""
    kind: Annotated[str, Query(pattern=r"^([a-z][a-z_]*(\.[a-z][a-z_]*)*)?$", max_length=64)] = ""
    queue: Annotated[str, Query(pattern=r"^(ingest|labeler|eval|notify)?$")] = ""
    owner: Annotated[str, Query(pattern=PLAIN, max_length=64)] = ""
    id_part: Annotated[str, Query(pattern=r"^([0-9a-f]{4,32})?$")] = ""
    sequence_id: Annotated[str, Query(pattern=r"^([0-9a-f]{32})?$")] = ""
    since: Annotated[str, Query(pattern=DAY)] = ""
    until: Annotated[str, Query(pattern=DAY)] = ""
    order: Annotated[str, Query(pattern=r"^(newest|oldest|longest)?$")] = ""
    cursor: Annotated[str, Query(max_length=LONGEST_CURSOR)] = ""

    def filters(self) -> AdminFilters:
        """Return the search as the API's filters."""
        given: dict[str, Any] = {key: value for key, value in asdict(self).items() if value and key not in OF_THE_PAGE}
        state = {"dead": {"dead": True}, "": {}}.get(self.list, {"state": self.list})
        return AdminFilters(**given, **state)

    @property
    def is_narrowed(self) -> bool:
        given = (self.kind, self.queue, self.owner, self.id_part, self.sequence_id, self.since, self.until)
        return any(given) or self.order not in ("", "newest")

    def in_days(self, zone: tzinfo) -> Select[Job]:
        """Select jobs created from the day `since` to the day `until`, both included, in the reader's zone."""
        statement = select(Job)
        if self.since:
            statement = statement.where(Job.created_ns >= _begins_ns(self.since, zone))
        if self.until:
            statement = statement.where(Job.created_ns < _begins_ns(self.until, zone, days=1))
        return statement


def _begins_ns(day: str, zone: tzinfo, days: int = 0) -> int:
    """Return the start of the day plus `days`; a day beyond its month's end counts into the next month."""
    year, month, number = map(int, day.split("-"))
    begins = datetime(year, month, 1) + timedelta(days=number - 1 + days)
    return int(begins.replace(tzinfo=zone).timestamp()) * 10**9


@router.get("/admin/jobs")
def jobs(
    request: Request,
    caller: Administrator,
    platform: PlatformDep,
    search: Annotated[JobSearch, Depends(at_once(JobSearch))],
) -> HTMLResponse:
    filters, in_days = search.filters(), search.in_days(zone_of(request))
    with platform.database.reading() as session:
        rows = _found(session, filters.narrowed(in_days), search)
        items = admin_job_items(session, rows.rows)
        counts = job_counts(session, filters.of_any_state(in_days), filters.flat(in_days))
        invalid = _invalid_submissions(session, [item.id for item in items])
        queues, workers = queue_items(session), worker_items(session, platform.settings)
        kinds = late_kinds(session)
    return page(
        request,
        caller,
        "admin/jobs.html",
        jobs=items,
        next=rows.next,
        search=search,
        lists=[(word, title, _count(counts.model_dump(), word)) for word, title in LISTS],
        queues=[(queue, bars(queue.per_minute, *SPARK)) for queue in queues],
        workers=workers,
        kinds=sorted({*kinds, search.kind} - {""}),
        invalid=invalid,
        queue_names=(*QUEUES, NOTIFY),
    )


def _found(session: Session, statement: Select[Job], search: JobSearch) -> PageRows[Job]:
    """Return a page in the order of the search; the longest jobs have one page only."""
    if search.order == "longest":
        lasted = Job.finished_ns - Job.started_ns
        ended = statement.where(lasted.is_not(None)).order_by(lasted.desc(), Job.id.desc()).limit(SHOWN)
        return PageRows(session.scalars(ended).all(), None)
    order = Job.id if search.order == "oldest" else Job.id.desc()
    return page_of(session, statement, order, PageQuery(search.cursor or None, SHOWN))


def _invalid_submissions(session: Session, job_ids: Sequence[str]) -> frozenset[str]:
    """Return the succeeded jobs that found a submission invalid."""
    invalid = select(SubmissionRow.job_id).where(SubmissionRow.job_id.in_(job_ids), SubmissionRow.state == "invalid")
    return frozenset(job_id for job_id in session.scalars(invalid) if job_id)


def _count(counts: dict[str, int], word: str) -> int:
    return counts[word] if word else sum(counts.values()) - counts["dead"]


# A job or run as its administrator sees it, at `/admin/jobs/{id}`: stages along time, attempts, log lines.


@router.get("/admin/jobs/{job_id}")
def job(job_id: IdPath, request: Request, caller: Administrator, platform: PlatformDep) -> HTMLResponse:
    with platform.database.reading() as session:
        row = job_of(session, caller, job_id)
        detail = admin_job_detail(session, row)
        spans = job_spans_of(session, row) if row.id == row.root_id else []
        root = session.get_one(Job, row.root_id)
        (run,) = job_items(session, [root])
    return page(
        request,
        caller,
        "admin/job.html",
        job=detail,
        root=root,
        run=run,
        picture=stage_picture(spans, now_ns()),
        is_over=row.state in TERMINAL,
        is_root_over=root.state in TERMINAL,
    )


# The queues with their switches, and the processes that work, at `/admin/queues`.


FIGURE = (600.0, 72.0)


@router.get("/admin/queues")
def queues(request: Request, caller: Administrator, platform: PlatformDep) -> HTMLResponse:
    wake_ups = pending_wake_ups_of(platform)
    with platform.database.reading() as session:
        items, workers = queue_items(session, wake_ups), worker_items(session, platform.settings)
        scrub, faults = scrub_status(session), noted_faults(session)
    return page(
        request,
        caller,
        "admin/queues.html",
        scrub=scrub,
        scrubbed_at=instant_or_none(scrub.passed_ns),
        faults=[(fault, instant(fault.found_ns)) for fault in faults],
        queues=[(queue, bars(queue.per_minute, *FIGURE, gap=3.0)) for queue in items],
        workers=workers,
        is_broker_reachable=all(count is not None for count in wake_ups.values()),
        missing_fences=missing_fences(),
    )
