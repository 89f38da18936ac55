"""ASGI middleware by which clients of other releases are understood, or told what to install.

**Conventions.** Only whoever says a release (`stone_base/releases.py`) is answered with ours: browsers and strangers
need not know it. A release that cannot be read says nothing.
"""

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.client_wheel import OLDEST_CLIENT
from api.errors import ClientTooOldError
from services.runtime.code_version import RELEASE
from stone_base.releases import HEADER, is_older


class Releases:
    """`Releases(app, install)`, an ASGI application around another; `install` is the line that a refusal ends with."""

    def __init__(self, app: ASGIApp, install: str) -> None:
        self._app, self._install = app, install

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        said = Headers(scope=scope).get(HEADER, "") if scope["type"] == "http" else ""
        if is_older(said, OLDEST_CLIENT):
            raise ClientTooOldError(said[:40], OLDEST_CLIENT, self._install)
        await self._app(scope, receive, _telling(send) if said else send)


def _telling(send: Send) -> Send:
    async def tell(message: Message) -> None:
        if message["type"] == "http.response.start":
            MutableHeaders(scope=message)[HEADER] = RELEASE
        await send(message)

    return tell
