"""The queues with their switches, and the processes that work, at `/admin/queues`."""

from fastapi import Request
from fastapi.responses import HTMLResponse

from api.deps import Administrator, PlatformDep
from api.noun_router import NounRouter
from api.views.admin import pending_wake_ups_of, queue_items, worker_items
from web.boards.sparks import bars
from web.rendering import page

router = NounRouter()
FIGURE = (600.0, 72.0)


@router.get("/admin/queues")
def queues(request: Request, caller: Administrator, platform: PlatformDep) -> HTMLResponse:
    wake_ups = pending_wake_ups_of(platform)
    with platform.database.reading() as session:
        items, workers = queue_items(session, wake_ups), worker_items(session, platform.settings)
    return page(
        request,
        caller,
        "admin/queues.html",
        queues=[(queue, bars(queue.per_minute, *FIGURE, gap=3.0)) for queue in items],
        workers=workers,
        is_broker_reachable=all(count is not None for count in wake_ups.values()),
    )
