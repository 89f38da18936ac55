"""The audit log, for administrators: read, and proven whole."""

from typing import Annotated

from fastapi import APIRouter, Depends, Query
from sqlalchemy import select

from api import audit
from api.deps import Caller, PlatformDep, require
from api.paging import Page, PageDep, page
from api.schemas.audit import AuditLine, AuditVerification
from api.schemas.base import PLAIN, IdQuery, LineQuery, instant
from services.runtime.orm import AuditEntry

router = APIRouter(prefix="/admin/audit-log", tags=["administration"])

Administrator = Annotated[Caller, Depends(require("admin", "administrator"))]
Subject = Annotated[str | None, Query(pattern=PLAIN, max_length=64)]


@router.get("", summary="Who did what, newest first")
def lines(
    _caller: Administrator,
    query: PageDep,
    platform: PlatformDep,
    act: LineQuery = None,
    actor_id: IdQuery = None,
    subject_id: Subject = None,
) -> Page[AuditLine]:
    wanted = {AuditEntry.act: act, AuditEntry.actor_id: actor_id, AuditEntry.subject_id: subject_id}
    found = select(AuditEntry).where(*(column == value for column, value in wanted.items() if value is not None))
    with platform.database.reading() as session:
        return page(session, found, AuditEntry.number.desc(), query).shown(_shown)


@router.get("/verification", summary="Whether the log is whole")
def verification(_caller: Administrator, platform: PlatformDep) -> AuditVerification:
    with platform.database.reading() as session:
        broken, head = audit.verify(session), audit.head(session)
    return AuditVerification(is_whole=broken is None, first_broken=broken, lines=head.number, head_hash=head.hash)


def _shown(row: AuditEntry) -> AuditLine:
    names = ("number", "actor_id", "actor", "act", "subject_id", "reason", "facts", "request_id", "hash")
    return AuditLine(**{name: getattr(row, name) for name in names}, logged_at=instant(row.logged_ns))
