"""Audit log lines and the check of their hash chain, as response bodies."""

from dataclasses import dataclass

from sqlalchemy import func, select
from sqlalchemy.orm import Session, aliased

from api.paging import Page, PageQuery, page
from api.schemas.audit import AuditLine
from api.schemas.base import instant
from services.runtime.orm import AuditEntry


@dataclass(frozen=True)
class AuditFilter:
    """Which lines: each that is said must be met."""

    act: str | None = None
    actor: str | None = None
    actor_id: str | None = None
    subject_id: str | None = None


def audit_page(session: Session, query: PageQuery, wanted: AuditFilter) -> Page[AuditLine]:
    """The lines that are wanted, newest first."""
    said = {
        AuditEntry.act: wanted.act,
        AuditEntry.actor: wanted.actor,
        AuditEntry.actor_id: wanted.actor_id,
        AuditEntry.subject_id: wanted.subject_id,
    }
    found = select(AuditEntry).where(*(column == value for column, value in said.items() if value))
    return page(session, found, AuditEntry.number.desc(), query).shown(audit_line)


def acts_known(session: Session) -> list[str]:
    """The acts that the log holds, by name: each is found as the first after the last, by a step down the index."""
    later = aliased(AuditEntry)
    acts = select(func.min(AuditEntry.act).label("act")).cte(recursive=True)
    after = select(func.min(later.act)).where(later.act > acts.c.act).correlate(acts).scalar_subquery()
    acts = acts.union_all(select(after).where(acts.c.act.is_not(None)))
    return list(session.scalars(select(acts.c.act).where(acts.c.act.is_not(None)).order_by(acts.c.act)))


def audit_line(row: AuditEntry) -> AuditLine:
    names = ("number", "actor_id", "actor", "act", "subject_id", "reason", "facts", "request_id", "hash")
    return AuditLine(**{name: getattr(row, name) for name in names}, logged_at=instant(row.logged_ns))
