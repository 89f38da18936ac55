"""The audit log: actors, acts, objects and reasons, and whether the log is intact."""

from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import HTMLResponse

from api.deps import Administrator, PlatformDep
from api.paging import LONGEST_CURSOR, PageQuery
from api.schemas.base import PLAIN
from api.views.audit import AuditFilter, acts_known, audit_page
from web.audit_words import VERBS, describe
from web.rendering import page

router = APIRouter()
SHOWN = 50
Word = Annotated[str, Query(pattern=PLAIN, max_length=64)]
Cursor = Annotated[str | None, Query(max_length=LONGEST_CURSOR)]


@router.get("/admin/audit")
def audit_log(
    request: Request,
    caller: Administrator,
    platform: PlatformDep,
    act: Word = "",
    actor: Word = "",
    subject_id: Word = "",
    cursor: Cursor = None,
) -> HTMLResponse:
    wanted = AuditFilter(act=act.strip(), actor=actor.strip(), subject_id=subject_id.strip())
    with platform.database.reading() as session:
        lines = audit_page(session, PageQuery(cursor, SHOWN), wanted)
        acts, entries = acts_known(session), describe(session, lines.items)
    return page(
        request, caller, "people/audit.html", lines=lines, entries=entries, acts=acts, wanted=wanted, verbs=VERBS
    )
