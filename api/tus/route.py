"""A route class that adds the tus version header to every response, refusals included."""

from fastapi.routing import APIRoute
from starlette.datastructures import MutableHeaders
from starlette.types import Message, Receive, Scope, Send

from api.tus.errors import VERSION


class TusRoute(APIRoute):
    """`NounRouter(route_class=TusRoute)`."""

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def say(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers["Tus-Resumable"] = VERSION
                if scope["method"] == "HEAD":  # an offset is true for a moment only
                    headers["Cache-Control"] = "no-store"
            await send(message)

        await super().handle(scope, receive, say)
