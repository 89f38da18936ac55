"""Deletes expired sessions, tokens, invitations and device grants, failed sign-ins, old addresses, idempotent replies.

**Conventions.** The sweeper runs it. Expired credentials are refused from their last second on, whether or not the row
still exists. A token stays listed for `TOKENS_SHOWN_NS` after its end, so that its owner sees why a program is refused.
"""

import structlog
from sqlalchemy import ColumnElement, delete, select
from sqlalchemy.orm import InstrumentedAttribute

from services.runtime.access.login_throttle import ADDRESSES_KEPT_NS, FORGOTTEN_NS
from services.runtime.jobs.changes import rows_changed
from services.runtime.orm import (
    AuditAnchor,
    AuditEntry,
    DeviceGrant,
    FailedSignInRow,
    IdempotentReply,
    SignInAddress,
    TeamInvitation,
    Token,
    WebSession,
)
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform

TOKENS_SHOWN_NS = 30 * 86_400 * 10**9
REPLIES_KEPT_NS = 86_400 * 10**9
INVITATIONS_SHOWN_NS = 30 * 86_400 * 10**9
AT_A_TIME = 1000
MOST_TIMES = 20


def forget_ended(platform: Platform) -> int:
    """Delete expired rows, of each kind at most `AT_A_TIME * MOST_TIMES`; return their number. Safe concurrently."""
    now, idle_ns = now_ns(), int(platform.settings.api.session_idle_s * 1e9)
    ended = (
        (WebSession.id, WebSession.expires_ns <= now),
        (WebSession.id, WebSession.used_ns <= now - idle_ns),
        (Token.id, Token.expires_ns <= now - TOKENS_SHOWN_NS),
        (TeamInvitation.id, TeamInvitation.expires_ns <= now - INVITATIONS_SHOWN_NS),
        (FailedSignInRow.key, FailedSignInRow.failed_ns <= now - FORGOTTEN_NS),
        (SignInAddress.key, SignInAddress.used_ns <= now - ADDRESSES_KEPT_NS),
        (DeviceGrant.id, DeviceGrant.expires_ns <= now),
        (IdempotentReply.id, IdempotentReply.created_ns <= now - REPLIES_KEPT_NS),
    )
    return sum(_delete_rows(platform, key, is_over) for key, is_over in ended)


def _delete_rows(platform: Platform, key: InstrumentedAttribute[str], is_over: ColumnElement[bool]) -> int:
    """Delete rows in several small transactions, so that other writers wait only briefly; return their number."""
    some = select(key).where(is_over).limit(AT_A_TIME)
    ended = delete(key.class_).where(key.in_(some), is_over)
    deleted = 0
    for _ in range(MOST_TIMES):
        with platform.database.transaction() as session:
            gone = rows_changed(session, ended)
        deleted += gone
        if gone < AT_A_TIME:
            break
    return deleted


# Retention of the audit log: deletes lines older than `STONE_RETENTION__AUDIT_S`, preserving the hash chain. An anchor
# stores the number and the hash of the last deleted line, from which the next line still follows, so an earlier noted
# head can still be verified. The database allows deletions only up to an anchor, and never changes anchors
# (`migrations`); the cut is also in the process's log. Lines younger than `LEAST_S` stay whatever the setting, so that
# a typo does not delete last week's trace.


LEAST_S = 90 * 86_400.0
AUDIT_LINES_AT_A_TIME = 10_000
MOST_AUDIT_TIMES = 5

log = structlog.get_logger(__name__)


def cut_audit(platform: Platform) -> int:
    """Delete expired lines, at most `AUDIT_LINES_AT_A_TIME * MOST_AUDIT_TIMES`; return their number.

    If the setting is 0, no line is deleted.
    """
    kept_s = platform.settings.retention.audit_s
    if not kept_s:
        return 0
    before_ns = now_ns() - int(max(kept_s, LEAST_S) * 1e9)
    removed = 0
    for _ in range(MOST_AUDIT_TIMES):
        gone = _cut_some(platform, before_ns)
        removed += gone
        if not gone:
            break
    return removed


def _cut_some(platform: Platform, before_ns: int) -> int:
    """Delete the oldest expired lines; lines are in the order of their numbers, so the first young line ends it."""
    with platform.database.transaction() as session:
        oldest = select(AuditEntry).order_by(AuditEntry.number).limit(AUDIT_LINES_AT_A_TIME)
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
