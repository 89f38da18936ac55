"""ASGI middleware that serves renamed paths by their earlier names, for one release.

**Conventions.** A request to an earlier path gets the response of the new path, with its name
(`Deprecation`, RFC 9745; `Link` with `successor-version`, RFC 5829). Few programs would follow a redirect.
"""

from collections.abc import Mapping
from urllib.parse import quote

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

RENAMED: Mapping[str, str] = {"/api/v1/users": "/api/v1/admin/users"}
DEPRECATED_SINCE = "@1796083200"  # 2026-12-01


class RenamedPaths:
    """An ASGI application around another that also accepts earlier paths."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        path = _successor(scope["path"]) if scope["type"] == "http" else None
        quoted = quote(path or "")
        if path is None:
            await self._app(scope, receive, send)
            return

        async def with_successor(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers["Deprecation"] = DEPRECATED_SINCE
                headers["Link"] = f'<{quoted}>; rel="successor-version"'
            await send(message)

        await self._app({**scope, "path": path, "raw_path": quoted.encode()}, receive, with_successor)


def _successor(path: str) -> str | None:
    for old, new in RENAMED.items():
        if path == old or path.startswith(f"{old}/"):
            return new + path.removeprefix(old)
    return None
