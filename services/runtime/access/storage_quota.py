"""The storage quota: an append-only ledger whose sum is the balance.

**Conventions.** Amounts are bytes, positive when taken, negative when given back; a subject (an upload's id) is what
they are taken for, and stays so when the upload has become a recording. Each function is part of the caller's
transaction and locks the owner's row, so that two reservations at once cannot both take the last bytes. The lock is
the weaker one (PostgreSQL `FOR NO KEY UPDATE`): rows that refer to the owner may be inserted meanwhile.
"""

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from services.runtime.notifications.events import QUOTA_LOW, NewEvent, record
from services.runtime.orm import QuotaEntry, User
from stone.errors import Refused

BYTES = "bytes"
LOW_RATIO = 0.9
"""From this share of the limit on the owner's storage is low."""


def reserve(session: Session, owner_id: str, amount: int, subject_id: str, reason: str, limit: int) -> None:
    """Take `amount` bytes for the subject. Raises `quota_exceeded`, and takes nothing then."""
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
    """Give back all that is taken for the subject; how many bytes that were. A second time it is 0."""
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
    """The bytes the owner has taken and not given back."""
    total = select(func.coalesce(func.sum(QuotaEntry.amount), 0)).where(QuotaEntry.owner_id == owner_id)
    return int(session.scalar(total) or 0)


def lock_owner(session: Session, owner_id: str) -> None:
    """Lock the owner's ledger, and whatever else is the owner's; on SQLite the transaction itself is the lock
    (`BEGIN IMMEDIATE`)."""
    session.execute(select(User.id).where(User.id == owner_id).with_for_update(key_share=True))


def _entry(owner_id: str, amount: int, subject_id: str, reason: str) -> QuotaEntry:
    return QuotaEntry(owner_id=owner_id, kind=BYTES, amount=amount, subject_id=subject_id, reason=reason)
