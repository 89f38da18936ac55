"""The sign-in page; signing out is on one's account's page."""

import re
from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import HTMLResponse

from api.callers import Looker
from web.rendering import page

router = APIRouter()
OURS = re.compile(r"/(?![/\\])[^\\\s]*")
"""A path of this site: never another host's address, which `//host` and `/\\host` are to a browser."""


@router.get("/sign-in")
def sign_in(request: Request, caller: Looker, back: Annotated[str, Query(max_length=2000)] = "/") -> HTMLResponse:
    return page(request, caller, "sign_in.html", back=back if OURS.fullmatch(back) else "/")
