"""ASGI middleware that sends Strict-Transport-Security if the public URL is https (RFC 6797).

**Conventions.** A year, this host alone; other hosts of the domain are not ours. If a proxy sends the header too,
browsers use the first.
"""

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

HEADER, VALUE = "Strict-Transport-Security", "max-age=31536000"


class Https:
    """An ASGI application around another; adds the header to every response."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def telling(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).setdefault(HEADER, VALUE)
            await send(message)

        await self._app(scope, receive, telling if scope["type"] == "http" else send)
