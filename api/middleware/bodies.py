"""ASGI middleware that bounds request bodies while they are read: size, time, sender and memory.

**Conventions.** The caller is identified before the first byte is read. If a route requires a caller, a body without
one is refused unread (401). Routes without a caller (`api/middleware/strangers.py`) read at most `STRANGERS_BYTES`.
Other bodies have at most `api.body_bytes`, whatever their Content-Length. They must arrive within `api.body_s` and one
more second for every `api.body_bytes_per_s` received (408). The bytes that a request holds count against a budget until
the request ends (`held_bytes.py`, 503).

The upload's own length limits pieces of files, which are written as they arrive (`api/tus/body_stream.py`). Forms may
have `uploads.form_bytes`, with at most `SPOOLED_BYTES` in memory. Forms and pieces of files may pause for
`uploads.idle_s` at most.
"""

import asyncio
from collections.abc import Collection
from dataclasses import dataclass

from starlette.datastructures import Headers
from starlette.formparsers import MultiPartParser
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.deps import identify_async
from api.errors import ApiError, RefusedBodyError, UnauthenticatedError, body_too_large, body_too_slow
from api.middleware.held_bytes import OVERHEAD_BYTES, BodyBudget
from api.middleware.limits import UPLOADS, address_of
from api.problems import answer_to
from services.runtime.settings import Settings

PIECES = "application/offset+octet-stream"
FORM = "multipart/form-data"
FORM_OVERHEAD_BYTES = 64 * 1024
STRANGERS_BYTES = 16 * 1024
SPOOLED_BYTES = MultiPartParser.spool_max_size


@dataclass(frozen=True)
class _BodyBounds:
    """The limits of a body in all and in memory, in bytes; a form has an idle time instead of a rate."""

    most_bytes: int
    held_bytes: int
    idle_s: float = 0.0
    is_strangers: bool = False


class BodyLimit:
    """An ASGI application that limits another's bodies; `strangers` are (method, path) of routes without a caller."""

    def __init__(self, app: ASGIApp, settings: Settings, strangers: Collection[tuple[str, str]]) -> None:
        self._app, self._uploads, self._api, self._strangers = app, settings.uploads, settings.api, strangers
        self.budget = BodyBudget(settings.api.held_body_bytes, settings.api.body_bytes)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        bounds = self._bounds_of(scope) if scope["type"] == "http" and _has_body(scope) else None
        if bounds is None:
            await self._app(scope, receive, send)
            return
        if _declared_bytes(scope) > bounds.most_bytes:
            await answer_to(body_too_large(bounds.most_bytes))(scope, receive, send)
            return
        body = _BoundedBody(await _sender_of(scope, bounds), receive, bounds, self)
        try:
            await self._app(scope, body, send)
        finally:
            body.release()

    def due_s(self, begun_s: float, came_bytes: int) -> float:
        """Return the time by which the next bytes of a body are due."""
        return begun_s + self._api.body_s + came_bytes / self._api.body_bytes_per_s

    def _bounds_of(self, scope: Scope) -> _BodyBounds | None:
        """Return the limits of the body; None if the route sets its own."""
        if (scope["method"], scope["path"]) in self._strangers:
            return _BodyBounds(STRANGERS_BYTES, STRANGERS_BYTES, is_strangers=True)
        kind = Headers(scope=scope).get("content-type", "").partition(";")[0].strip().lower()
        is_upload = scope["path"] == UPLOADS or scope["path"].startswith(f"{UPLOADS}/")
        if is_upload and kind == PIECES:
            return None
        if is_upload and kind == FORM:
            most_bytes = self._uploads.form_bytes + FORM_OVERHEAD_BYTES
            return _BodyBounds(most_bytes, SPOOLED_BYTES, self._uploads.idle_s)
        return _BodyBounds(self._api.body_bytes, self._api.body_bytes)


class _BoundedBody:
    """A receive channel that raises if the body exceeds its limits."""

    def __init__(self, sender: str, receive: Receive, bounds: _BodyBounds, limit: BodyLimit) -> None:
        self._sender, self._receive, self._bounds, self._limit = sender, receive, bounds, limit
        self._came_bytes = self._held_bytes = 0
        self._begun_s, self._is_whole = 0.0, False

    async def __call__(self) -> Message:
        if self._is_whole:
            return await self._receive()
        try:
            if not self._held_bytes:
                self._begin()
            message = await self._next()
            self._count(len(message.get("body", b"")))
        except ApiError as refusal:
            raise RefusedBodyError(refusal) from refusal
        self._is_whole = not message.get("more_body", False)
        return message

    def release(self) -> None:
        """Release the held bytes to the budget."""
        if self._held_bytes:
            self._limit.budget.give_back(self._sender, self._held_bytes)
            self._held_bytes = 0

    def _begin(self) -> None:
        if not self._sender:
            raise UnauthenticatedError()
        self._begun_s = asyncio.get_running_loop().time()
        self._hold(OVERHEAD_BYTES)

    async def _next(self) -> Message:
        idle_s, now_s = self._bounds.idle_s, asyncio.get_running_loop().time()
        due_s = now_s + idle_s if idle_s else self._limit.due_s(self._begun_s, self._came_bytes)
        try:
            async with asyncio.timeout_at(due_s):
                return await self._receive()
        except TimeoutError:
            raise body_too_slow(self._came_bytes, now_s - self._begun_s) from None

    def _count(self, size_bytes: int) -> None:
        self._came_bytes += size_bytes
        if self._came_bytes > self._bounds.most_bytes:
            raise body_too_large(self._bounds.most_bytes)
        self._hold(min(self._came_bytes, self._bounds.held_bytes) + OVERHEAD_BYTES - self._held_bytes)

    def _hold(self, size_bytes: int) -> None:
        self._limit.budget.take(self._sender, size_bytes)
        self._held_bytes += size_bytes


async def _sender_of(scope: Scope, bounds: _BodyBounds) -> str:
    """Return the user, or the address if the route needs no caller; empty if the body must stay unread."""
    request = Request(scope)
    try:
        caller = await identify_async(request)
    except UnauthenticatedError:
        del request.state.caller  # the route identifies again and reports the reason
        caller = None
    if caller is not None:
        return f"user {caller.user_id}"
    return address_of(request) if bounds.is_strangers else ""


def _has_body(scope: Scope) -> bool:
    names = (b"content-length", b"transfer-encoding")
    return any(name in names and value != b"0" for name, value in scope["headers"])


def _declared_bytes(scope: Scope) -> int:
    """Return the Content-Length, or 0 if it is not a number."""
    declared = Headers(scope=scope).get("content-length", "0")
    return int(declared[:18]) if declared.isascii() and declared.isdigit() else 0
