"""People: one's own account with its tokens and browsers; for administrators the users and each one's tokens and acts.

**Conventions.** A secret is shown once, by the module that got it in the API's answer; no page is rendered with one.
"""

from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from fastapi.responses import HTMLResponse

from api.deps import Administrator, PlatformDep, Reader
from api.paging import LONGEST_CURSOR, PageQuery
from api.schemas.base import PLAIN, IdPath
from api.views.audit import AuditFilter, audit_page
from api.views.notifications import deliveries_page, notifications_item
from api.views.people import browsers_of, storage_of, tokens_page, user_item, user_of, users_page
from services.runtime.access.roles import ROLES, SCOPES
from services.runtime.orm import User
from services.runtime.orm.base import now_ns
from web.audit_words import describe
from web.rendering import page

router = APIRouter()
SHOWN = 50
LINES = PageQuery(None, 20)
DELIVERIES = 10
MAY = {
    "participant": "Downloads the dataset, submits to benchmarks.",
    "curator": "Uploads, processes and exports sequences.",
    "administrator": "Manages jobs, splits, benchmarks and users.",
}
ALLOWS = {
    "read": "view and download",
    "submit": "submit to benchmarks",
    "upload": "upload and process",
    "admin": "administer",
    "account": "manage tokens and sessions",
}
Part = Annotated[str, Query(pattern=PLAIN, max_length=64)]
Cursor = Annotated[str | None, Query(max_length=LONGEST_CURSOR)]


@router.get("/account")
def account(
    request: Request,
    caller: Reader,
    platform: PlatformDep,
    cursor: Cursor = None,
    email_secret: Annotated[str, Query(pattern="^[A-Za-z0-9_-]{0,64}$")] = "",
) -> HTMLResponse:
    with platform.database.reading() as session:
        own = session.get_one(User, caller.user_id)
        values: dict[str, Any] = {
            "tokens": tokens_page(session, PageQuery(cursor, SHOWN), caller.user_id),
            "browsers": browsers_of(session, caller.user_id, caller.credential_id),
            "has_password": bool(own.password_hash),
            "storage": storage_of(platform, session, own),
            "told": notifications_item(session, caller.user_id, platform.settings),
            "deliveries": deliveries_page(session, PageQuery(None, DELIVERIES), caller.user_id).items,
        }
    return page(
        request,
        caller,
        "people/account.html",
        email_secret=email_secret,
        scopes=[scope for scope in SCOPES if scope in caller.scopes],
        may=MAY[caller.role],
        allows=ALLOWS,
        base=platform.settings.api.url.rstrip("/"),
        longest_s=int(platform.settings.api.token_s),
        now_ns=now_ns(),
        **values,
    )


@router.get("/admin/users")
def users(
    request: Request,
    caller: Administrator,
    platform: PlatformDep,
    name: Part = "",
    role: Part = "",
    cursor: Cursor = None,
) -> HTMLResponse:
    with platform.database.reading() as session:
        users_shown = users_page(session, PageQuery(cursor, SHOWN), name, role)
    return page(request, caller, "people/users.html", users=users_shown, name=name, role=role, may=MAY, roles=ROLES)


@router.get("/admin/users/{user_id}")
def user(request: Request, caller: Administrator, platform: PlatformDep, user_id: IdPath) -> HTMLResponse:
    with platform.database.reading() as session:
        row = user_of(session, user_id)
        values: dict[str, Any] = {
            "user": user_item(row),
            "storage": storage_of(platform, session, row),
            "tokens": tokens_page(session, PageQuery(None, 200), user_id),
            "about": describe(session, audit_page(session, LINES, AuditFilter(subject_id=user_id)).items),
            "by": describe(session, audit_page(session, LINES, AuditFilter(actor_id=user_id)).items),
            "browsers": browsers_of(session, user_id, ""),
        }
    return page(request, caller, "people/user.html", may=MAY, allows=ALLOWS, roles=ROLES, **values)
