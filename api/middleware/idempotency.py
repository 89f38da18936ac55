"""Idempotency-Key middleware: a creating request sent twice is executed once and gets the same response twice.

**Conventions.** Any POST under `/api/v1` by a known caller may have a key of 1 to 128 visible ASCII characters. A key
belongs to one caller, path, role and set of scopes for a day, so no credential with fewer rights receives the response.
A browser's request without its CSRF token is not looked up, and the route refuses it. Responses below 400 are repeated,
with `Idempotency-Replayed: true`. Refusals and faults changed nothing and are not kept, so the same key may be used
again. Another body with the same key: 422. A repetition while the first request is in progress: 409. A response with
`no-store` or a cookie contains a secret; it is not kept, and its repetition is a 409 with this reason. A JSON body
identifies a request; for a form or a piece of a file only the head does.
"""

import re
from asyncio import sleep
from collections.abc import AsyncIterator, Callable, Mapping
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import partial
from hashlib import sha256
from time import monotonic
from typing import Any

from sqlalchemy import delete, event, select, update
from sqlalchemy.exc import IntegrityError, OperationalError
from sqlalchemy.orm import Session
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.deps import Caller, check_csrf, identify, platform_of
from api.errors import ApiError, CsrfError, UnauthenticatedError
from services.runtime.database.transactions import Database
from services.runtime.orm import IdempotentReply
from services.runtime.orm.base import now_ns

# Stored replies of idempotent requests: reserved, marked as done, replayed, deleted after a day.
#
# **Conventions.** `status` of a row is 0 while in progress, and 1 when the request took effect and is being answered.
# It is 2 if the response is not kept (a secret, or too large), else the response's own status. The transaction that
# takes effect also sets 1. After a crash and the end of the lease, a row with 0 had no effect, so the request may run
# again; a row with 1 must not run again.


IN_WORK, TOOK_EFFECT, NOT_KEPT = 0, 1, 2
KEPT_NS = 24 * 3600 * 10**9

working_for: ContextVar[str] = ContextVar("idempotent_reply", default="")


@dataclass(frozen=True)
class IdempotentRequest:
    """A request as its caller identified it; `lease_ns` exceeds the duration of any such request."""

    user_id: str
    route: str
    key: str
    sha256: str
    lease_ns: int


@dataclass(frozen=True)
class StoredReply:
    """A stored response."""

    status: int
    headers: Mapping[str, str]
    body: bytes


def reserve(database: Database, asked: IdempotentRequest) -> StoredReply | str:
    """Return the response kept for this key, or the id of the row that is reserved for this request.

    Raises `idempotency_key_reused`, `request_in_flight`, `reply_not_kept`.
    """
    fresh = IdempotentReply(user_id=asked.user_id, route=asked.route, key=asked.key, request_sha256=asked.sha256)
    try:
        with database.transaction() as session:
            old = IdempotentReply.created_ns < now_ns() - KEPT_NS
            session.execute(delete(IdempotentReply).where(IdempotentReply.user_id == asked.user_id, old))
            session.add(fresh)
            session.flush()
            return fresh.id
    except IntegrityError:
        return _resume(database, asked)


def keep(database: Database, row_id: str, reply: StoredReply | None) -> None:
    """Store the response; without one, record that the request took effect."""
    values: dict[str, object] = {"status": NOT_KEPT}
    if reply is not None:
        values = {"status": reply.status, "headers": dict(reply.headers), "body": reply.body}
    with database.transaction() as session:
        session.execute(update(IdempotentReply).where(IdempotentReply.id == row_id).values(**values))


def release(database: Database, row_id: str) -> None:
    """Delete the row of a refused request, so that its key can be used again."""
    with database.transaction() as session:
        session.execute(delete(IdempotentReply).where(IdempotentReply.id == row_id))


def give_up(database: Database, row_id: str) -> None:
    """Delete the row of a request that ended in a fault, unless it took effect: its commit may have succeeded
    unnoticed.
    """
    mine = IdempotentReply.id == row_id
    with database.transaction() as session:
        session.execute(delete(IdempotentReply).where(mine, IdempotentReply.status == IN_WORK))
        session.execute(update(IdempotentReply).where(mine).values(status=NOT_KEPT))


def _resume(database: Database, asked: IdempotentRequest) -> StoredReply | str:
    """Handle a key that already has a row: return its response or take over the row."""
    with database.transaction() as session:
        same = (IdempotentReply.user_id == asked.user_id, IdempotentReply.route == asked.route)
        known = select(IdempotentReply).where(*same, IdempotentReply.key == asked.key).with_for_update()
        row = session.scalars(known).one_or_none()
        if row is None:  # it failed and was deleted in the meantime
            raise request_in_flight()
        if row.request_sha256 != asked.sha256:
            raise ApiError(
                "idempotency_key_reused",
                "this Idempotency-Key was already used with another body or query; use a new key",
            )
        if row.status == NOT_KEPT:
            raise reply_not_kept()
        if row.status not in (IN_WORK, TOOK_EFFECT):
            return StoredReply(row.status, row.headers, row.body)
        if abs(now_ns() - row.created_ns) < asked.lease_ns:
            raise request_in_flight()
        if row.status == TOOK_EFFECT:
            raise reply_not_kept()
        row.created_ns = now_ns()  # its process died before it took effect
        return row.id


@event.listens_for(Session, "before_commit")
def _mark(session: Session) -> None:
    """Mark the request's key as done, within the request's own transaction."""
    row_id = working_for.get()
    if row_id:
        mine = update(IdempotentReply).where(IdempotentReply.id == row_id, IdempotentReply.status == IN_WORK)
        session.execute(mine.values(status=TOOK_EFFECT), execution_options={"synchronize_session": False})


KEY = re.compile("[!-~]{1,128}")
MOST_KEPT_BYTES = 64 * 1024
LEASE_NS = 60 * 10**9
STREAM_LEASE_NS = 6 * 3600 * 10**9  # a form's body arrives while the request runs
OUTAGE_S, ASK_AGAIN_S = 20.0, 0.2  # covers a restart of the database; the client waits longer
DESCRIBING = ("content-type", "content-length", "upload-length", "upload-metadata", "upload-defer-length")


class Idempotency:
    """An ASGI application around another that replays stored responses."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        key = _key_of(scope)
        caller = await run_in_threadpool(_caller, Request(scope)) if key is not None else None
        if key is None or caller is None:
            await self._app(scope, receive, send)
            return
        if not KEY.fullmatch(key):
            raise ApiError(
                "bad_idempotency_key",
                f"an Idempotency-Key requires 1 to 128 visible ASCII characters; this key has {len(key)}",
            )
        body = None if _is_streamed(scope) else await _read(receive)
        lease_ns = STREAM_LEASE_NS if body is None else LEASE_NS
        route = _route_of(scope, caller)
        identified = IdempotentRequest(caller.user_id, route, key, _fingerprint(scope, body), lease_ns)
        await self._answer(scope, receive if body is None else _ReplayedBody(receive, body), send, identified)

    async def _answer(self, scope: Scope, receive: Receive, send: Send, asked: IdempotentRequest) -> None:
        database = platform_of(Request(scope)).database
        held = await run_in_threadpool(reserve, database, asked)
        if isinstance(held, StoredReply):
            again = Response(held.body, held.status, {**held.headers, "Idempotency-Replayed": "true"})
            await again(scope, receive, send)
            return
        outcome = _RecordedReply(send)
        mark = working_for.set(held)
        try:
            await self._app(scope, receive, outcome)
        finally:
            working_for.reset(mark)
            await _write(partial(_record_end, database, held, outcome))
        await outcome.pass_on()


@dataclass
class _RecordedReply:
    """A response held back until it is stored; if it is too large to store, it is sent at once, except its end."""

    send: Send
    messages: list[Message] = field(default_factory=list)
    size_bytes: int = 0
    status: int = 0

    async def __call__(self, message: Message) -> None:
        self.status = self.status or message.get("status", 0)
        self.size_bytes += len(message.get("body", b""))
        if self.size_bytes > MOST_KEPT_BYTES and message.get("more_body"):
            await self.pass_on()
        self.messages.append(message)

    @property
    def is_success(self) -> bool:
        return 200 <= self.status < 400

    def reply(self) -> StoredReply | None:
        """Return the reply to store, or None if it contains a secret or is too large."""
        if self.size_bytes > MOST_KEPT_BYTES:
            return None
        headers = Headers(raw=self.messages[0]["headers"])
        if "no-store" in headers.get("cache-control", "") or "set-cookie" in headers:
            return None
        body = b"".join(message.get("body", b"") for message in self.messages[1:])
        return StoredReply(self.status, {k: v for k, v in headers.items() if k != "content-length"}, body)

    async def pass_on(self) -> None:
        waiting, self.messages = self.messages, []
        for message in waiting:
            await self.send(message)


@dataclass
class _ReplayedBody:
    """The body that was already read; afterwards the client's further messages."""

    receive: Receive
    body: bytes
    is_given: bool = False

    async def __call__(self) -> Message:
        if self.is_given:
            return await self.receive()
        self.is_given = True
        return {"type": "http.request", "body": self.body, "more_body": False}


def _record_end(database: Database, held: str, outcome: _RecordedReply) -> None:
    """Record how the request ended."""
    if outcome.is_success:
        keep(database, held, outcome.reply())
    elif 400 <= outcome.status < 500:
        release(database, held)
    else:
        give_up(database, held)


async def _write(write: Callable[[], None]) -> None:
    """Write with retries while the database restarts; without the write, a repetition would wait for the lease."""
    until_s = monotonic() + OUTAGE_S
    while True:
        try:
            return await run_in_threadpool(write)
        except OperationalError:
            if monotonic() > until_s:
                raise
        await sleep(ASK_AGAIN_S)


def _key_of(scope: Scope) -> str | None:
    if scope["type"] != "http" or scope["method"] != "POST" or not scope["path"].startswith("/api/v1/"):
        return None
    return Headers(scope=scope).get("idempotency-key")


def _caller(request: Request) -> Caller | None:
    """Return the caller whose key it is, or None if the request will be refused anyway."""
    try:
        caller = identify(request)
        if caller is not None:
            check_csrf(request, caller)
    except (UnauthenticatedError, CsrfError):
        return None
    return caller


def _is_streamed(scope: Scope) -> bool:
    kind = Headers(scope=scope).get("content-type", "").partition(";")[0].strip().lower()
    return kind not in ("", "application/json") and not kind.endswith("+json")


async def _read(receive: Receive) -> bytes:
    return b"".join([piece async for piece in _pieces(receive)])


async def _pieces(receive: Receive) -> AsyncIterator[bytes]:
    is_more = True
    while is_more:
        message: Any = await receive()
        if message["type"] == "http.disconnect":
            raise ClientDisconnect()
        yield message.get("body", b"")
        is_more = message.get("more_body", False)


def _route_of(scope: Scope, caller: Caller) -> str:
    """Return the sha256 of the path and of the caller's rights."""
    allowed = "\n".join([scope["path"], caller.role, *sorted(caller.scopes)])
    return sha256(allowed.encode()).hexdigest()


def _fingerprint(scope: Scope, body: bytes | None) -> str:
    headers = Headers(scope=scope)
    described = [headers.get(name, "") for name in DESCRIBING] if body is None else []
    head = "\n".join([scope["path"], scope["query_string"].decode("latin-1"), *described])
    return sha256(head.encode() + b"\0" + (body or b"")).hexdigest()


def request_in_flight() -> ApiError:
    return ApiError(
        "request_in_flight",
        "the first request with this Idempotency-Key is still in progress; try again in a second",
        {"Retry-After": "1"},
    )


def reply_not_kept() -> ApiError:
    return ApiError(
        "reply_not_kept",
        "the first request with this Idempotency-Key took effect, but its response was not kept; "
        "look for its result in the list",
    )
