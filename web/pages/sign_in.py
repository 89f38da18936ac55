"""The sign-in page; signing out is on one's account's page."""

from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import HTMLResponse

from api.deps import Looker, PlatformDep
from api.own_pages import LONGEST, own_page
from api.views.people import sign_in_ways
from web.first_steps import first_password_of
from web.rendering import page

router = APIRouter()
Back = Annotated[str, Query(max_length=LONGEST)]


@router.get("/sign-in")
def sign_in(request: Request, caller: Looker, platform: PlatformDep, back: Back = "/") -> HTMLResponse:
    ways, first = sign_in_ways(platform.settings), first_password_of(request)
    return page(request, caller, "sign_in.html", back=own_page(back), ways=ways, first_password=first)
