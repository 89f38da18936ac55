"""Where every request comes in and every answer goes out: id, access log, metrics, security headers, faults.

**Conventions.** Outermost of all: whatever is raised inside becomes a problem here at the latest. An answer that a
route gave a header of its own keeps it. The access log has one line a request, with the route's template, never the
query (cursors and names are nobody's business) and never a credential.
"""

import re
import time
from typing import Any

import structlog
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect, Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from structlog.contextvars import bound_contextvars

from api.context import begin
from api.metrics import Meters
from api.problems import Shown, respond

HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "X-Frame-Options": "DENY",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "private, no-cache",
}
CLIENT_LEFT = 499

log = structlog.get_logger("access")


class Entry:
    """`Entry(app, meters, shown)`, an ASGI application around another; `shown` as in `api/problems.py`."""

    def __init__(self, app: ASGIApp, meters: Meters, shown: Shown) -> None:
        self._app, self._meters, self._shown = app, meters, shown

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request_id = begin(Headers(scope=scope).get("x-request-id", ""))
        with bound_contextvars(request_id=request_id):
            await self._answer(scope, receive, _Outgoing(send, request_id))

    async def _answer(self, scope: Scope, receive: Receive, outgoing: "_Outgoing") -> None:
        begun = time.perf_counter()
        try:
            await self._app(scope, receive, outgoing)
        except ClientDisconnect:
            outgoing.status = CLIENT_LEFT
        except Exception as error:
            response = self._shown(Request(scope, receive), respond(error))
            if outgoing.status:
                raise  # too late for another answer: the server cuts the connection, so the client sees it is not whole
            await response(scope, receive, outgoing)
        finally:
            self._note(scope, outgoing.status, time.perf_counter() - begun)

    def _note(self, scope: Scope, status: int, lasted_s: float) -> None:
        route = template_of(scope)
        self._meters.note(scope["method"], route, status, lasted_s)
        client: Any = scope.get("client") or ("", 0)
        caller = getattr(scope.get("state", {}).get("caller"), "name", "")
        facts = {"method": scope["method"], "route": route, "status": status, "caller": caller, "client": client[0]}
        log.info("request", lasted_ms=round(lasted_s * 1e3, 2), **facts)


class _Outgoing:
    """The way out: sets the headers every answer has, and remembers the status."""

    def __init__(self, send: Send, request_id: str) -> None:
        self._send, self._request_id = send, request_id
        self.status = 0

    async def __call__(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self.status = message["status"]
            headers = MutableHeaders(scope=message)
            headers["X-Request-ID"] = self._request_id
            for name, value in HEADERS.items():
                headers.setdefault(name, value)
        await self._send(message)


def template_of(scope: Scope) -> str:
    """The route's path with its parameters' names, so that ids do not become labels; `unmatched` without a route."""
    if "endpoint" not in scope:
        return "unmatched"
    path, rest = str(scope["path"]), ""
    for name, value in reversed(scope.get("path_params", {}).items()):
        found = list(re.finditer(rf"/{re.escape(str(value))}(?=[/.]|$)", path))
        if found:  # of several the last: what is behind it has been replaced
            path, rest = path[: found[-1].start()], f"/{{{name}}}{path[found[-1].end() :]}{rest}"
    return path + rest
