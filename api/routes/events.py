"""Server-sent events of a job, of a sequence's jobs, or of a submission.

**Conventions.** `id` is the subject's version. A client that reconnects with it as Last-Event-ID receives only newer
states. An event's data is the job, sequence or submission as its GET route returns it; `event` is `progress`, or
`ended` for the last one. A client that has received the last event gets 204, which ends a browser's reconnecting. A
stream lasts `LONGEST_S` at most. Before each event and each heartbeat the caller is identified again, and the subject
is looked up as its route does. A stream ends with its credential, with its user's access, or when the subject is no
longer visible to the caller.
"""

import time
from asyncio import sleep
from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from typing import Annotated

from anyio import CancelScope
from fastapi import APIRouter, Header, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import StreamingResponse
from fastapi.sse import KEEPALIVE_COMMENT, format_sse_event
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session
from starlette.types import Receive, Scope, Send

from api.answers import Responses, refusals
from api.deps import Caller, PlatformDep, Reader, identify_again
from api.errors import NotFoundError, UnauthenticatedError
from api.event_streams import TICK_S, Follower, StreamSnapshot, StreamSubject
from api.schemas.base import IdPath
from api.views.jobs import job_detail
from api.views.sequences import sequence_detail
from api.views.submissions import submission_detail
from api.visible import job_of, sequence_of, submission_of
from services.domain.benchmarks.submissions.state_machine import ENDED
from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import Job, SequenceRow, SubmissionRow
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform

router = APIRouter(tags=["events"])
EVENT_STREAM = "text/event-stream"
KEEPALIVE_S = 15.0
LONGEST_S = 900.0
RETRY_MS = 1000
LastEventId = Annotated[
    str | None, Header(pattern=r"^\d{1,18}$", description="`id` of the last event that was received.")
]
EVENT = {
    "type": "object",
    "properties": {
        "event": {"type": "string", "enum": ["progress", "ended"]},
        "id": {"type": "string"},
        "data": {"type": "string", "contentMediaType": "application/json"},
    },
}
EVENTS = {
    "description": "Server-sent events of three lines each: `event` (`progress` or `ended`), `id`, and `data` (JSON).",
    "examples": ['event: progress\nid: 7\ndata: {"state": "running"}\n\n'],
}
STREAM: Responses = {
    200: {
        "description": "Events until the job, sequence or submission has ended",
        "content": {EVENT_STREAM: {"schema": EVENTS, "x-itemSchema": EVENT}},
    },
    204: {"description": "Ended, and the caller has received the last event"},
    **refusals(403, 404, 429),
}


@router.get("/jobs/{job_id}/events", summary="Follow a job by events", response_class=Response, responses=STREAM)
async def follow_job(
    job_id: IdPath, caller: Reader, platform: PlatformDep, request: Request, last_event_id: LastEventId = None
) -> Response:
    """Send the progress of a job or run, at most twice a second, until it has ended."""

    def subject(session: Session, caller: Caller) -> StreamSubject:
        job = job_of(session, caller, job_id)
        return StreamSubject("run" if job.id == job.root_id else "job", job.id)

    return await _streamed(request, platform, caller, subject, last_event_id)


@router.get(
    "/sequences/{sequence_id}/events",
    summary="Follow a sequence by events",
    response_class=Response,
    responses=STREAM,
)
async def follow_sequence(
    sequence_id: IdPath, caller: Reader, platform: PlatformDep, request: Request, last_event_id: LastEventId = None
) -> Response:
    """Send the progress of its runs and its changes; the stream ends when the sequence is deleted."""

    def subject(session: Session, caller: Caller) -> StreamSubject:
        return StreamSubject("sequence", sequence_of(session, caller, sequence_id).id)

    return await _streamed(request, platform, caller, subject, last_event_id)


@router.get(
    "/submissions/{submission_id}/events",
    summary="Follow a submission by events",
    response_class=Response,
    responses=STREAM,
)
async def follow_submission(
    submission_id: IdPath, caller: Reader, platform: PlatformDep, request: Request, last_event_id: LastEventId = None
) -> Response:
    """Send the progress of a submission, until it has ended."""

    def subject(session: Session, caller: Caller) -> StreamSubject:
        return StreamSubject("submission", submission_of(session, caller, submission_id).id)

    return await _streamed(request, platform, caller, subject, last_event_id)


Find = Callable[[Session, Caller], StreamSubject]


class EventStream(StreamingResponse):
    """Events for one connection; the slot is released however the stream ends."""

    def __init__(self, events: AsyncGenerator[bytes], leave: Callable[[], None]) -> None:
        headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
        super().__init__(events, media_type=EVENT_STREAM, headers=headers)
        self._events, self._leave = events, leave

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._leave()
            with CancelScope(shield=True):
                await self._events.aclose()


async def _streamed(
    request: Request, platform: Platform, caller: Caller, find: Find, last_event_id: str | None
) -> Response:
    follower, seen = _follower(request, platform), None if last_event_id is None else int(last_event_id)

    def look() -> tuple[StreamSubject, StreamSnapshot]:
        with platform.database.reading() as session:
            subject = find(session, caller)
        return subject, follower.look(subject)

    def check_shown() -> bool:
        """Return whether the subject is still visible. Raises `UnauthenticatedError`."""
        now = identify_again(request)
        with platform.database.lookups() as session:
            try:
                return "read" in now.scopes and find(session, now) == subject
            except NotFoundError:
                return False

    subject, now = await run_in_threadpool(look)
    if now.is_over and now.version == seen:
        return Response(status_code=204)
    follower.sit(caller.user_id)
    lasting_s = min(LONGEST_S, (caller.expires_ns - now_ns()) / 1e9)
    snapshots = follower.snapshots(subject, seen, min(KEEPALIVE_S, lasting_s))
    return EventStream(_events(snapshots, check_shown, lasting_s), lambda: follower.leave(caller.user_id))


async def _events(
    newer: AsyncGenerator[StreamSnapshot | None], check_shown: Callable[[], bool], lasting_s: float
) -> AsyncGenerator[bytes]:
    until_s = time.monotonic() + lasting_s
    yield format_sse_event(retry=RETRY_MS)
    async with aclosing(newer) as snapshots:
        async for snapshot in snapshots:
            is_shown = await _is_still_shown(check_shown, until_s)
            if snapshot is not None and snapshot.is_over and is_shown is False:
                snapshot = StreamSnapshot(snapshot.version, "{}", is_over=True)  # deleted, or no longer visible
            elif not is_shown:
                return
            yield KEEPALIVE_COMMENT if snapshot is None else _event(snapshot)
            if time.monotonic() >= until_s:
                return


async def _is_still_shown(check_shown: Callable[[], bool], until_s: float) -> bool | None:
    """Return whether the subject is still visible to the caller; None if their credential has ended.

    While the database is unavailable, nothing is sent.
    """
    while time.monotonic() < until_s:
        try:
            return await run_in_threadpool(check_shown)
        except UnauthenticatedError:
            return None
        except SQLAlchemyError:
            await sleep(TICK_S)
    return None


def _event(snapshot: StreamSnapshot) -> bytes:
    name = "ended" if snapshot.is_over else "progress"
    return format_sse_event(data_str=snapshot.json, event=name, id=str(snapshot.version))


def _follower(request: Request, platform: Platform) -> Follower:
    """Return the follower of this application, created once, on the event loop."""
    state = request.app.state
    if not hasattr(state, "follower"):
        state.follower = Follower(platform.database, load)
    follower: Follower = state.follower
    return follower


def load(session: Session, subject: StreamSubject) -> tuple[str, bool]:
    """Return the subject as its GET route returns it, and whether it has ended or is deleted."""
    if subject.kind == "sequence":
        sequence = session.get(SequenceRow, subject.id)
        if sequence is None:
            return "{}", True
        return sequence_detail(session, sequence).model_dump_json(), sequence.deleted_ns is not None
    if subject.kind == "submission":
        row = session.get(SubmissionRow, subject.id)
        return (submission_detail(session, row).model_dump_json(), row.state in ENDED) if row else ("{}", True)
    job = session.get(Job, subject.id)
    return (job_detail(session, job).model_dump_json(), job.state in TERMINAL) if job else ("{}", True)
