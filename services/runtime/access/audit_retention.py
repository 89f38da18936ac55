"""Retention of the audit log: cuts off lines older than `STONE_RETENTION__AUDIT_S`, keeping the hash chain.

**Conventions.** An anchor holds the number and the hash of the last line that went; the next line still follows from
it, so whoever noted a head before can go on checking. The database lets lines go only up to an anchor, and never
changes one (`migrations`); the cut is in the process's own log. What is younger than `LEAST_S` stays whatever is set:
a mistyped figure must not cost the trace of last week.
"""

import structlog
from sqlalchemy import delete, select

from services.runtime.orm import AuditAnchor, AuditEntry
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform

LEAST_S = 90 * 86_400.0
AT_A_TIME = 10_000
MOST_TIMES = 5

log = structlog.get_logger(__name__)


def cut_audit(platform: Platform) -> int:
    """Remove lines that are old enough, at most `AT_A_TIME * MOST_TIMES`; how many went. With 0 set none is."""
    kept_s = platform.settings.retention.audit_s
    if not kept_s:
        return 0
    before_ns = now_ns() - int(max(kept_s, LEAST_S) * 1e9)
    removed = 0
    for _ in range(MOST_TIMES):
        gone = _cut_some(platform, before_ns)
        removed += gone
        if not gone:
            break
    return removed


def _cut_some(platform: Platform, before_ns: int) -> int:
    """The oldest of them. Lines stand in the order of their numbers; the first young one ends it."""
    with platform.database.transaction() as session:
        oldest = select(AuditEntry).order_by(AuditEntry.number).limit(AT_A_TIME)
        old = []
        for entry in session.scalars(oldest):
            if entry.logged_ns > before_ns:
                break
            old.append((entry.number, entry.hash))
        if not old:
            return 0
        number, line_hash = old[-1]
        session.expunge_all()
        session.add(AuditAnchor(number=number, hash=line_hash))
        session.flush()
        session.execute(delete(AuditEntry).where(AuditEntry.number <= number))
    log.info("audit log cut", last=number, hash=line_hash, lines=len(old))
    return len(old)
