"""The public page with the client's install command, the wheel and the starter code."""

from fastapi import APIRouter, Request, Response
from fastapi.responses import HTMLResponse

from api.client_wheel import ClientWheel, install_line
from api.deps import Looker, PlatformDep
from api.errors import NotFoundError
from api.files import GeneratedFile, answer_made
from services.domain.benchmarks.starter import FILENAME, starter_code
from web.rendering import page

router = APIRouter()
WHEEL = "application/octet-stream"


@router.get("/downloads/")
def show_downloads(request: Request, caller: Looker, platform: PlatformDep) -> HTMLResponse:
    wheel: ClientWheel | None = request.app.state.client_wheel
    url = platform.settings.api.url.rstrip("/")
    return page(request, caller, "downloads.html", wheel=wheel, line=install_line(url, wheel), url=url)


@router.get(f"/downloads/{FILENAME}")
def send_starter(request: Request) -> Response:
    """Return the starter code of participants, without sign-in."""
    return answer_made(request, starter_code(), GeneratedFile("text/x-python", FILENAME))


@router.get("/downloads/{filename}")
def send_wheel(filename: str, request: Request) -> Response:
    """Return the wheel without sign-in, as pip sends no token. Raises `NotFoundError`, `range_not_satisfiable`."""
    wheel: ClientWheel | None = request.app.state.client_wheel
    if wheel is None or filename != wheel.filename:
        raise NotFoundError("download", filename)
    return answer_made(request, wheel.content, GeneratedFile(WHEEL, wheel.filename))
