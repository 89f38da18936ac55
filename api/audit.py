"""Audit log entries of requests: the actor, the act, its subject and the reason.

**Conventions.** An act and its line share one transaction. `services/runtime/access/audit_chain.py` keeps the chain.
"""

from collections.abc import Mapping
from typing import Any

from sqlalchemy.orm import Session

from api.deps import Caller
from api.errors import ApiError
from api.middleware.context import request_id
from services.runtime.access.audit_chain import AuditHead, append, canonical, cut, hash_of, head, verify
from services.runtime.orm import AuditEntry

__all__ = ["AuditHead", "canonical", "cut", "hash_of", "head", "record", "record_admin_act", "verify"]


def record(
    session: Session,
    caller: Caller | None,
    act: str,
    subject_id: str,
    reason: str = "",
    facts: Mapping[str, Any] | None = None,
) -> None:
    """Add a line to the log in this transaction. `facts` is a small JSON object without secrets."""
    entry = AuditEntry(act=act, subject_id=subject_id, reason=reason)
    entry.actor_id, entry.actor = (caller.user_id, caller.name) if caller else ("", "anonymous")
    entry.request_id = request_id()
    append(session, entry, facts)


def record_admin_act(
    session: Session,
    caller: Caller,
    act: str,
    subject_id: str,
    reason: str,
    facts: Mapping[str, Any] | None = None,
) -> None:
    """Add a line for an act that only an administrator may do. Raises `reason_missing` for an empty reason."""
    if not reason.strip():
        raise ApiError("reason_missing", f"{act} requires a reason for the audit log")
    record(session, caller, act, subject_id, reason.strip(), facts)
