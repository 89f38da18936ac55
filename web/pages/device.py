"""The page on which a user approves a program that signs in by a browser (`stone auth login --browser`).

**Conventions.** A code in the URL only fills the field. The page shows the program, its address and scopes, and
approval requires a press of the button (RFC 8628, 5.4).
"""

from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import HTMLResponse

from api.deps import AccountHolder, PlatformDep
from services.runtime.access import device_grants
from services.runtime.orm.base import now_ns
from web.pages.people import ALLOWS
from web.rendering import page

router = APIRouter()
NS_PER_MIN = 60 * 10**9
Code = Annotated[str, Query(max_length=32)]


@router.get("/device")
def device(
    request: Request, caller: AccountHolder, platform: PlatformDep, code: Code = "", done: Code = ""
) -> HTMLResponse:
    """Show the field for a program's code, then the program and its scopes; `done` is the user's decision."""
    grant = None
    if code:
        request.app.state.limits.admit_guess(caller.user_id)
        with platform.database.reading() as session:
            grant = device_grants.find_waiting(session, code)
    return page(
        request,
        caller,
        "people/device.html",
        code=code,
        grant=grant,
        scopes=device_grants.scopes_for(grant, caller.scopes) if grant else [],
        minutes=max(1, (grant.expires_ns - now_ns()) // NS_PER_MIN) if grant else 0,
        done=done,
        allows=ALLOWS,
    )
