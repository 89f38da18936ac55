"""Idempotency-Key middleware: a creating request sent twice is executed once and answered twice the same.

**Conventions.** Any POST under `/api/v1` by a known caller may carry a key of 1 to 128 visible ASCII characters. A key
belongs to one caller, path, role and set of scopes for a day, so no credential with fewer rights receives the answer. A
browser's request without its CSRF token is not looked up, and the route refuses it. Answers below 400 are repeated,
with `Idempotency-Replayed: true`. Refusals and faults changed nothing and are not kept, so the same key may be used
again. Another body with the same key: 422. A repetition while the first request is in progress: 409. An answer with
`no-store` or a cookie holds a secret; it is not kept, and its repetition is a 409 with this reason. A JSON body
identifies a request; of a form or a piece of a file only the head does.
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
# **Conventions.** `status` of a row: 0, being worked on; 1, took effect and is being answered; 2, took effect and its
# answer is not kept (it holds a secret, or is too large); else the answer's own. The step from 0 to 1 is part of the
# very transaction that takes effect, so what a crash leaves behind is known once the lease has run out: after 0
# nothing happened and the request may be worked on again; after 1 it must not be.


IN_WORK, TOOK_EFFECT, NOT_KEPT = 0, 1, 2
KEPT_NS = 24 * 3600 * 10**9

working_for: ContextVar[str] = ContextVar("idempotent_reply", default="")


@dataclass(frozen=True)
class IdempotentRequest:
    """A request as its caller identified it; `lease_ns` is longer than any such request lasts."""

    user_id: str
    route: str
    key: str
    sha256: str
    lease_ns: int


@dataclass(frozen=True)
class StoredReply:
    """An answer that was kept."""

    status: int
    headers: Mapping[str, str]
    body: bytes


def reserve(database: Database, asked: IdempotentRequest) -> StoredReply | str:
    """The answer kept for this key, or the id of the row that is now ours to work for.

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
    """Keep the answer; without one, note that there was an effect."""
    values: dict[str, object] = {"status": NOT_KEPT}
    if reply is not None:
        values = {"status": reply.status, "headers": dict(reply.headers), "body": reply.body}
    with database.transaction() as session:
        session.execute(update(IdempotentReply).where(IdempotentReply.id == row_id).values(**values))


def release(database: Database, row_id: str) -> None:
    """Forget the request: it was refused, and the next one with this key is worked on."""
    with database.transaction() as session:
        session.execute(delete(IdempotentReply).where(IdempotentReply.id == row_id))


def give_up(database: Database, row_id: str) -> None:
    """Forget a request that ended in a fault, unless it took effect: its commit may only not have been heard of."""
    mine = IdempotentReply.id == row_id
    with database.transaction() as session:
        session.execute(delete(IdempotentReply).where(mine, IdempotentReply.status == IN_WORK))
        session.execute(update(IdempotentReply).where(mine).values(status=NOT_KEPT))


def _resume(database: Database, asked: IdempotentRequest) -> StoredReply | str:
    """The reaction to a key that is known already."""
    with database.transaction() as session:
        same = (IdempotentReply.user_id == asked.user_id, IdempotentReply.route == asked.route)
        known = select(IdempotentReply).where(*same, IdempotentReply.key == asked.key).with_for_update()
        row = session.scalars(known).one_or_none()
        if row is None:  # it failed and was forgotten in this very moment
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
        row.created_ns = now_ns()  # its process died before anything happened
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
STREAM_LEASE_NS = 6 * 3600 * 10**9  # a form's body comes while it is worked on
OUTAGE_S, ASK_AGAIN_S = 20.0, 0.2  # a restart of the database; the client waits longer than that
DESCRIBING = ("content-type", "content-length", "upload-length", "upload-metadata", "upload-defer-length")


class Idempotency:
    """An ASGI application that answers repeated requests in the place of another."""

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
        asked = IdempotentRequest(caller.user_id, route, key, _fingerprint(scope, body), lease_ns)
        await self._answer(scope, receive if body is None else _ReplayedBody(receive, body), send, asked)

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
            await _note(partial(_ended, database, held, outcome))
        await outcome.pass_on()


@dataclass
class _RecordedReply:
    """The answer, held back until it is kept; an answer too large to keep is sent as it comes, except its end."""

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
        """The reply to keep: nothing of an answer that holds a secret or is too large."""
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
    """The body that was read, once more; afterwards what the client still says."""

    receive: Receive
    body: bytes
    is_given: bool = False

    async def __call__(self) -> Message:
        if self.is_given:
            return await self.receive()
        self.is_given = True
        return {"type": "http.request", "body": self.body, "more_body": False}


def _ended(database: Database, held: str, outcome: _RecordedReply) -> None:
    """Write down how the request ended."""
    if outcome.is_success:
        keep(database, held, outcome.reply())
    elif 400 <= outcome.status < 500:
        release(database, held)
    else:
        give_up(database, held)


async def _note(write: Callable[[], None]) -> None:
    """Once the database is there: a reply that is not written down makes its repetition wait for the lease."""
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
    """Whose key it is; nobody's when the request will be refused anyway."""
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
