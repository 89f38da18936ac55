"""The public help page: first steps of the reader's role, guides, keyboard shortcuts and the release."""

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from api.deps import Looker, PlatformDep
from services.runtime.code_version import RELEASE
from web.first_steps import steps_for
from web.rendering import page

router = APIRouter()


@router.get("/help")
def show_help(request: Request, caller: Looker, platform: PlatformDep) -> HTMLResponse:
    with platform.database.reading() as session:
        steps = steps_for(session, caller)
    return page(request, caller, "help.html", steps=steps, release=RELEASE)
