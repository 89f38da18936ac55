"""The first page: the newest labelled sequence in 3D, and the board of the newest benchmark."""

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from api.callers import Looker
from web.rendering import page

router = APIRouter()


@router.get("/")
def home(request: Request, caller: Looker) -> HTMLResponse:
    return page(request, caller, "home.html")
