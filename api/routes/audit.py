"""Routes for administrators: read the audit log and verify its hash chain."""

from typing import Annotated

from fastapi import APIRouter, Depends, Query

from api import audit
from api.deps import Caller, PlatformDep, require
from api.paging import Page, PageDep
from api.schemas.audit import AuditLine, AuditVerification
from api.schemas.base import PLAIN, IdQuery, LineQuery
from api.views.audit import AuditFilter, audit_page

router = APIRouter(prefix="/admin/audit-log", tags=["administration"])

Administrator = Annotated[Caller, Depends(require("admin", "administrator"))]
Subject = Annotated[str | None, Query(pattern=PLAIN, max_length=64)]


@router.get("", summary="List the audit log, newest first")
def list_audit_lines(
    _caller: Administrator,
    query: PageDep,
    platform: PlatformDep,
    act: LineQuery = None,
    actor_id: IdQuery = None,
    subject_id: Subject = None,
    actor: LineQuery = None,
) -> Page[AuditLine]:
    with platform.database.reading() as session:
        return audit_page(session, query, AuditFilter(act, actor, actor_id, subject_id))


@router.get("/verification", summary="Verify the integrity of the audit log")
def verify_audit_log(_caller: Administrator, platform: PlatformDep) -> AuditVerification:
    with platform.database.reading() as session:
        broken, head = audit.verify(session), audit.head(session)
    return AuditVerification(is_whole=broken is None, first_broken=broken, lines=head.number, head_hash=head.hash)
