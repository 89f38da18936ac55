"""The page that says the one line which installs the client, and the wheel itself; for everybody."""

from fastapi import APIRouter, Request, Response
from fastapi.responses import HTMLResponse

from api.callers import Looker
from api.client_wheel import ClientWheel, install_line
from api.deps import PlatformDep
from api.errors import NotFoundError
from api.files import GeneratedFile, answer_made
from web.rendering import page

router = APIRouter()
WHEEL = "application/octet-stream"


@router.get("/downloads/")
def show_downloads(request: Request, caller: Looker, platform: PlatformDep) -> HTMLResponse:
    wheel: ClientWheel | None = request.app.state.client_wheel
    url = platform.settings.api.url.rstrip("/")
    return page(request, caller, "downloads.html", wheel=wheel, line=install_line(url, wheel), url=url)


@router.get("/downloads/{filename}")
def send_wheel(filename: str, request: Request) -> Response:
    """The wheel, without sign-in: pip brings no token. Raises `NotFoundError`, `RangeError`."""
    wheel: ClientWheel | None = request.app.state.client_wheel
    if wheel is None or filename != wheel.filename:
        raise NotFoundError("download", filename)
    return answer_made(request, wheel.content, GeneratedFile(WHEEL, wheel.filename))
