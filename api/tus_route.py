"""A route whose every answer, refusals too, says that the server speaks tus."""

from typing import Any

from fastapi.routing import APIRoute
from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.tus_errors import VERSION


class TusRoute(APIRoute):
    """`APIRouter(route_class=TusRoute)`."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.app = _saying_tus(self.app)


def _saying_tus(app: ASGIApp) -> ASGIApp:
    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        async def say(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers["Tus-Resumable"] = VERSION
                if scope["method"] == "HEAD":  # an offset is true for a moment only
                    headers["Cache-Control"] = "no-store"
            await send(message)

        await app(scope, receive, say)

    return answer
