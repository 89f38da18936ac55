"""The storage quota: an append-only ledger whose sum is the balance.

**Conventions.** Amounts are bytes, positive if reserved, negative if released. The subject of an amount (an upload's
id) stays the same when the upload becomes a recording. Each function is part of the caller's transaction and locks the
owner's row, so that two concurrent reservations cannot both take the last bytes. The weak lock (PostgreSQL `FOR NO KEY
UPDATE`) allows inserts of rows that refer to the owner.
"""

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from services.runtime.notifications.events import QUOTA_LOW, NewEvent, record
from services.runtime.orm import QuotaEntry, User
from stone.errors import Refused

BYTES = "bytes"
LOW_RATIO = 0.9
"""The owner's storage is low from this share of the limit on."""


def reserve(session: Session, owner_id: str, amount: int, subject_id: str, reason: str, limit: int) -> None:
    """Reserve `amount` bytes for the subject. Raises `quota_exceeded`, and then reserves nothing."""
    lock_owner(session, owner_id)
    used = balance(session, owner_id)
    if used + amount > limit:
        raise Refused(
            "quota_exceeded",
            f"{used} of {limit} bytes are used and {amount} more were requested; delete recordings, label sets or "
            "unfinished uploads that are no longer needed",
        )
    session.add(_entry(owner_id, amount, subject_id, reason))
    session.flush()
    if used < LOW_RATIO * limit <= used + amount:
        facts = {"what": "storage", "used_bytes": used + amount, "limit_bytes": limit}
        record(session, NewEvent(QUOTA_LOW, "", user_id=owner_id, facts=facts))


def count(session: Session, owner_id: str, amount: int, subject_id: str, reason: str) -> None:
    """Charge `amount` bytes for the subject, or release them if negative, without checking the limit.

    For small files that follow from a permitted request.
    """
    if amount:
        lock_owner(session, owner_id)
        session.add(_entry(owner_id, amount, subject_id, reason))
        session.flush()


def release(session: Session, subject_id: str, reason: str) -> int:
    """Release all bytes of the subject; return their number, 0 if already released."""
    owners = select(QuotaEntry.owner_id).where(QuotaEntry.subject_id == subject_id).distinct()
    released = 0
    for owner_id in sorted(session.scalars(owners)):
        lock_owner(session, owner_id)
        of_subject = (QuotaEntry.owner_id == owner_id, QuotaEntry.subject_id == subject_id)
        taken = session.scalar(select(func.coalesce(func.sum(QuotaEntry.amount), 0)).where(*of_subject)) or 0
        if taken:
            session.add(_entry(owner_id, -int(taken), subject_id, reason))
            released += int(taken)
    session.flush()
    return released


def balance(session: Session, owner_id: str) -> int:
    """Return the bytes that the owner uses."""
    total = select(func.coalesce(func.sum(QuotaEntry.amount), 0)).where(QuotaEntry.owner_id == owner_id)
    return int(session.scalar(total) or 0)


def lock_owner(session: Session, owner_id: str) -> None:
    """Lock the owner's ledger and other rows of the owner; on SQLite the transaction is the lock."""
    session.execute(select(User.id).where(User.id == owner_id).with_for_update(key_share=True))


def _entry(owner_id: str, amount: int, subject_id: str, reason: str) -> QuotaEntry:
    return QuotaEntry(owner_id=owner_id, kind=BYTES, amount=amount, subject_id=subject_id, reason=reason)
