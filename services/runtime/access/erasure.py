"""Erasure of a user account: personal data are deleted, the user's work stays without a name.

**Conventions.** The row stays, since ledgers refer to its id; its name becomes `erased-` and random letters. Lines of
the audit log keep the actor's name as long as the log is kept (`audit_retention`), because accountability outlives the
account. Sequences, calibrations and submissions are deleted separately, before or after. The sign-in provider still has
the user; a later sign-in creates a new account.
"""

from secrets import token_hex

from sqlalchemy import delete
from sqlalchemy.orm import Session

from services.runtime.access.login_throttle import forgive_name
from services.runtime.access.users import change_user
from services.runtime.orm import (
    DeviceGrant,
    EmailAddress,
    ExternalIdentity,
    IdempotentReply,
    NotificationChoice,
    NotificationDelivery,
    NotificationEvent,
    SignInAddress,
    Token,
    User,
    Webhook,
    WebSession,
)

ERASED = "erased-"
HELD = (
    *(Token, WebSession, SignInAddress, IdempotentReply, ExternalIdentity, DeviceGrant),
    *(EmailAddress, Webhook, NotificationChoice, NotificationDelivery, NotificationEvent),
)


def erase_user(session: Session, user: User) -> None:
    """Erase the account permanently and end its credentials at once. Raises `last_administrator`."""
    change_user(session, user, None, is_active=False)
    forgive_name(session, user.name)
    for held in HELD:
        session.execute(delete(held).where(held.user_id == user.id))
    user.name, user.password_hash = f"{ERASED}{token_hex(8)}", ""
    session.flush()
