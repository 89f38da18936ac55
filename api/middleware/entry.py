"""The outermost ASGI middleware: request ids, access log, request metrics, security headers, internal errors.

**Conventions.** Every exception becomes a problem here at the latest. Headers set by a route are kept. The access log
has one line per request, with the route's template; like its span, it never contains the query (cursors and names are
private) or a credential. A `traceparent` from outside becomes a link. It becomes the span's parent only if
`STONE_API__TRUSTS_TRACEPARENT` states that our proxy sets it: clients must not choose our trace ids or sampling.
"""

import re
import time
from contextlib import AbstractContextManager, nullcontext
from http import HTTPStatus
from typing import Any

import structlog
from opentelemetry.trace import INVALID_SPAN, Span, SpanKind
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect, Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from structlog.contextvars import bound_contextvars

from api.client_wheel import OLDEST_CLIENT
from api.errors import ApiError
from api.metrics import RequestMetrics
from api.middleware.context import begin
from api.problems import Shown, respond
from services.runtime.code_version import RELEASE
from services.runtime.telemetry.origins import context_of, link_to
from services.runtime.telemetry.tracing import mark_failed, span
from stone_base.releases import HEADER, is_older

HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "X-Frame-Options": "DENY",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "private, no-cache",
}
CLIENT_LEFT = 499
UNTRACED = ("/healthz", "/readyz", "/metrics")

log = structlog.get_logger("access")


class RequestMiddleware:
    """`RequestMiddleware(app, meters, shown)`, an ASGI application around another; `shown` as in `api/problems.py`."""

    def __init__(self, app: ASGIApp, meters: RequestMetrics, shown: Shown, *, trusts_traceparent: bool) -> None:
        self._app, self._meters, self._shown = app, meters, shown
        self._trusts_traceparent = trusts_traceparent

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        request_id = begin(headers.get("x-request-id", ""))
        with bound_contextvars(request_id=request_id), self._span(scope, headers) as made:
            if not self._trusts_traceparent:
                link_to(headers.get("traceparent", ""))
            outgoing = _Outgoing(send, request_id)
            await self._answer(scope, _Incoming(receive), outgoing)
            _tell(made, scope, outgoing.status, request_id)

    def _span(self, scope: Scope, headers: Headers) -> AbstractContextManager[Span]:
        """Start the span of a request, except of probes; its name and attributes are set when the route is known."""
        if scope["path"] in UNTRACED:
            return nullcontext(INVALID_SPAN)
        offered = headers.get("traceparent", "")
        within = context_of(offered) if self._trusts_traceparent else None
        return span(scope["method"], SpanKind.SERVER, within=within)

    async def _answer(self, scope: Scope, receive: "_Incoming", outgoing: "_Outgoing") -> None:
        begun = time.perf_counter()
        try:
            await self._app(scope, receive, outgoing)
        except ClientDisconnect:
            outgoing.status = CLIENT_LEFT
        except Exception as error:
            response = self._shown(Request(scope, receive), respond(error))
            if outgoing.status:
                raise  # too late for another response: the server closes the connection, so the client detects the cut
            await response(scope, receive, outgoing)
        finally:
            self._note(scope, outgoing.status, time.perf_counter() - begun)
            self._meters.note_bytes(receive.came_bytes, outgoing.went_bytes)

    def _note(self, scope: Scope, status: int, lasted_s: float) -> None:
        route = template_of(scope)
        self._meters.note(scope["method"], route, status, lasted_s)
        client: Any = scope.get("client") or ("", 0)
        caller = getattr(scope.get("state", {}).get("caller"), "name", "")
        facts = {"method": scope["method"], "route": route, "status": status, "caller": caller, "client": client[0]}
        log.info("request", lasted_ms=round(lasted_s * 1e3, 2), **facts)


class _Incoming:
    """The receive channel; counts the received bytes."""

    def __init__(self, receive: Receive) -> None:
        self._receive = receive
        self.came_bytes = 0

    async def __call__(self) -> Message:
        message = await self._receive()
        self.came_bytes += len(message.get("body", b""))
        return message


class _Outgoing:
    """The send channel; sets the common headers, and records the status and the sent bytes."""

    def __init__(self, send: Send, request_id: str) -> None:
        self._send, self._request_id = send, request_id
        self.status = self.went_bytes = 0

    async def __call__(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self.status = message["status"]
            headers = MutableHeaders(scope=message)
            headers["X-Request-ID"] = self._request_id
            for name, value in HEADERS.items():
                headers.setdefault(name, value)
        await self._send(message)
        self.went_bytes += len(message.get("body", b""))


def _tell(made: Span, scope: Scope, status: int, request_id: str) -> None:
    """Set the span's name and attributes, without path or query, which contain private names."""
    if not made.is_recording():
        return
    method, route = scope["method"], template_of(scope)
    made.update_name(f"{method} {route}")
    attributes = {"http.request.method": method, "http.route": route, "stone.request.id": request_id}
    made.set_attributes({**attributes, "http.response.status_code": status})
    if status >= HTTPStatus.INTERNAL_SERVER_ERROR:
        mark_failed(made, str(status))


def template_of(scope: Scope) -> str:
    """Return the route's path template, so that ids do not become labels; `unmatched` without a route."""
    if "endpoint" not in scope:
        return "unmatched"
    path, rest = str(scope["path"]), ""
    for name, value in reversed(scope.get("path_params", {}).items()):
        matches = list(re.finditer(rf"/{re.escape(str(value))}(?=[/.]|$)", path))
        if matches:  # the last replaced the earlier ones
            path, rest = path[: matches[-1].start()], f"/{{{name}}}{path[matches[-1].end() :]}{rest}"
    return path + rest


# Client version check: ASGI middleware that refuses unsupported client releases with the upgrade command.
# **Conventions.** A caller that sends its release (`stone_base/releases.py`) gets ours in the response; browsers need
# none. An unreadable release is ignored.


class Releases:
    """`Releases(app, install)`, an ASGI application around another; a refusal ends with the line `install`."""

    def __init__(self, app: ASGIApp, install: str) -> None:
        self._app, self._install = app, install

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        release = Headers(scope=scope).get(HEADER, "") if scope["type"] == "http" else ""
        if is_older(release, OLDEST_CLIENT):
            raise ApiError(
                "client_too_old",
                f"this client has release {release[:40]}; this server requires {OLDEST_CLIENT} or newer; "
                f"update the client: {self._install}",
                {"Upgrade": f"stone-client/{OLDEST_CLIENT}"},
            )
        await self._app(scope, receive, _telling(send) if release else send)


def _telling(send: Send) -> Send:
    async def tell(message: Message) -> None:
        if message["type"] == "http.response.start":
            MutableHeaders(scope=message)[HEADER] = RELEASE
        await send(message)

    return tell
