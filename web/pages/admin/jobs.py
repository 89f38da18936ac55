"""The administrator's view of the work: queues, workers and everybody's jobs, at `/admin/jobs`."""

from dataclasses import asdict, dataclass
from typing import Annotated, Any

from fastapi import Depends, Query, Request
from fastapi.responses import HTMLResponse
from sqlalchemy import select

from api.deps import Administrator, PlatformDep, at_once
from api.noun_router import NounRouter
from api.paging import LONGEST_CURSOR, PageQuery
from api.paging import page as page_of
from api.routes.admin.admin_jobs import AdminFilters
from api.schemas.base import PLAIN
from api.views.admin import admin_job_items, job_counts, late_kinds, queue_items, worker_items
from services.domain.notifications.spread import QUEUE as NOTIFY
from services.runtime.jobs.broker_app import QUEUES
from services.runtime.orm import Job
from web.boards.sparks import bars
from web.rendering import page

router = NounRouter()
SHOWN = 50
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
    cursor: Annotated[str, Query(max_length=LONGEST_CURSOR)] = ""

    def filters(self) -> AdminFilters:
        """The same as the API's filters."""
        said: dict[str, Any] = {
            key: value for key, value in asdict(self).items() if value and key not in ("list", "cursor")
        }
        state = {"dead": {"dead": True}, "": {}}.get(self.list, {"state": self.list})
        return AdminFilters(**said, **state)

    @property
    def is_narrowed(self) -> bool:
        return bool(self.kind or self.queue or self.owner or self.id_part or self.sequence_id)


@router.get("/admin/jobs")
def jobs(
    request: Request,
    caller: Administrator,
    platform: PlatformDep,
    search: Annotated[JobSearch, Depends(at_once(JobSearch))],
) -> HTMLResponse:
    filters = search.filters()
    with platform.database.reading() as session:
        found = page_of(session, filters.narrowed(select(Job)), Job.id.desc(), PageQuery(search.cursor or None, SHOWN))
        items = admin_job_items(session, found.rows)
        counts = job_counts(session, filters.of_any_state(select(Job)), filters.flat(select(Job)))
        queues, workers = queue_items(session), worker_items(session, platform.settings)
        kinds = late_kinds(session)
    return page(
        request,
        caller,
        "admin/jobs.html",
        jobs=items,
        next=found.next,
        search=search,
        lists=[(word, title, _count(counts.model_dump(), word)) for word, title in LISTS],
        queues=[(queue, bars(queue.per_minute, *SPARK)) for queue in queues],
        workers=workers,
        kinds=kinds,
        queue_names=(*QUEUES, NOTIFY),
    )


def _count(counts: dict[str, int], word: str) -> int:
    return counts[word] if word else sum(counts.values()) - counts["dead"]
