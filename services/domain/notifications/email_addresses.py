"""A user's e-mail address, which receives notifications once the user has followed the mailed link.

**Conventions.** The link's secret is created when it is mailed, stored as a hash, lasts `LASTS_NS`, and works once for
the requesting account. Setting an address may mail a third party, so an account may send `MOST_MAILS` of them a day.
"""

from hashlib import sha256
from hmac import compare_digest
from secrets import token_urlsafe

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from services.runtime.notification_settings import NotificationSettings
from services.runtime.notifications.events import EMAIL_VERIFICATION, NewEvent, record
from services.runtime.orm import EmailAddress, NotificationEvent, User
from services.runtime.orm.base import now_ns
from services.runtime.settings_checks import EMAIL
from stone.errors import Refused

DAY_NS = 86_400 * 10**9
LASTS_NS = DAY_NS
MOST_MAILS = 5
LONGEST = 254


def set_address(session: Session, user_id: str, address: str, settings: NotificationSettings) -> EmailAddress:
    """Set the user's address, unverified, and mail a link to it.

    Raises `no_email`, `bad_email_address`, `too_many_verifications`.
    """
    if not settings.smtp_host:
        raise Refused("no_email", "e-mail is not configured on this platform (SMTP)")
    if len(address) > LONGEST or not EMAIL.fullmatch(address):
        raise Refused(
            "bad_email_address",
            f"{address[:80]!r} is not an e-mail address such as ada@example.org (at most 254 ASCII characters)",
        )
    session.execute(select(User.id).where(User.id == user_id).with_for_update(key_share=True))  # serialises a user
    mails = select(func.count()).select_from(NotificationEvent).where(NotificationEvent.user_id == user_id)
    mails = mails.where(NotificationEvent.kind == EMAIL_VERIFICATION, NotificationEvent.created_ns > now_ns() - DAY_NS)
    if (session.scalar(mails) or 0) >= MOST_MAILS:
        raise Refused(
            "too_many_verifications",
            f"{MOST_MAILS} verification e-mails were sent for your account today; try again tomorrow",
        )
    row = session.get(EmailAddress, user_id) or EmailAddress(user_id=user_id)
    row.address, row.verified_ns, row.secret_hash, row.expires_ns = address, None, "", 0
    session.add(row)
    session.flush()
    record(session, NewEvent(EMAIL_VERIFICATION, "", user_id=user_id))
    return row


def remove_address(session: Session, user_id: str) -> None:
    """Delete the user's address, if any."""
    row = session.get(EmailAddress, user_id)
    if row is not None:
        session.delete(row)
        session.flush()


def new_secret(session: Session, row: EmailAddress) -> str:
    """Return a new secret for the link to be mailed; earlier links become invalid."""
    secret = token_urlsafe(32)
    row.secret_hash, row.expires_ns = _hash(secret), now_ns() + LASTS_NS
    session.flush()
    return secret


def verify(session: Session, user_id: str, secret: str) -> EmailAddress:
    """Verify the user's address with the secret of the link. Raises `email_not_verified`."""
    row = session.get(EmailAddress, user_id, with_for_update=True)
    is_right = row is not None and compare_digest(row.secret_hash, _hash(secret)) and row.expires_ns > now_ns()
    if row is None or not is_right:
        raise Refused(
            "email_not_verified",
            "this link is outdated, older than a day, or belongs to another account; request a new link",
        )
    row.verified_ns, row.secret_hash = now_ns(), ""
    session.flush()
    return row


def _hash(secret: str) -> str:
    return sha256(secret.encode()).hexdigest()
