"""ASGI middleware that limits the size of request bodies while they are read, whatever Content-Length says.

**Conventions.** Of uploads, pieces of files are bounded by the upload's own length and pass, and forms may have
`uploads.form_bytes`; everything else may have `api.body_bytes`, which is read into memory, perhaps before anybody has
asked who is calling.
"""

from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.errors import body_too_large
from api.middleware.limits import UPLOADS
from api.problems import answer_to
from services.runtime.settings import Settings

PIECES = "application/offset+octet-stream"
FORM = "multipart/form-data"
FORM_OVERHEAD_BYTES = 64 * 1024


class _TooLargeError(HTTPException):
    """An `HTTPException`, since FastAPI passes on no other kind from within the reading of a body."""

    def __init__(self, limit_bytes: int) -> None:
        super().__init__(413)
        self.limit_bytes = limit_bytes


class BodyLimit:
    """An ASGI application that bounds what another may read."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app, self._settings = app, settings

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        limit_bytes = self.limit_of(scope) if scope["type"] == "http" else None
        if limit_bytes is None:
            await self._app(scope, receive, send)
            return
        if _declared_bytes(scope) > limit_bytes:
            await answer_to(body_too_large(limit_bytes))(scope, receive, send)
            return
        await self._app(scope, _CountedReceive(receive, limit_bytes), send)

    def limit_of(self, scope: Scope) -> int | None:
        """The most bytes this request's body may have; None where the route bounds it."""
        kind = Headers(scope=scope).get("content-type", "").partition(";")[0].strip().lower()
        is_upload = scope["path"] == UPLOADS or scope["path"].startswith(f"{UPLOADS}/")
        if is_upload and kind == PIECES:
            return None
        if is_upload and kind == FORM:
            return self._settings.uploads.form_bytes + FORM_OVERHEAD_BYTES
        return self._settings.api.body_bytes


class _CountedReceive:
    """A receive channel that counts bytes and fails beyond the limit."""

    def __init__(self, receive: Receive, limit_bytes: int) -> None:
        self._receive, self._limit_bytes, self._left_bytes = receive, limit_bytes, limit_bytes

    async def __call__(self) -> Message:
        message = await self._receive()
        self._left_bytes -= len(message.get("body", b""))
        if self._left_bytes < 0:
            raise _TooLargeError(self._limit_bytes)
        return message


def _declared_bytes(scope: Scope) -> int:
    """The Content-Length; 0 where it is no number."""
    declared = Headers(scope=scope).get("content-length", "0")
    return int(declared[:18]) if declared.isascii() and declared.isdigit() else 0
