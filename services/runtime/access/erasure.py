"""Erasure of a user account: personal data is deleted, what the user made stays without a name.

**Conventions.** The row stays, since ledgers refer to it by id; its name becomes `erased-` and random letters. Lines of
the audit log keep the name under which somebody acted, for as long as the log is kept (`audit_retention`): they are
there to be held against whoever would rather be forgotten. Sequences, calibrations and submissions are deleted by
themselves, before or after. The provider by which somebody signed in knows them still: coming back, they are another.
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
    """Shut out at once, for good. Raises `last_administrator`."""
    change_user(session, user, None, is_active=False)
    forgive_name(session, user.name)
    for held in HELD:
        session.execute(delete(held).where(held.user_id == user.id))
    user.name, user.password_hash = f"{ERASED}{token_hex(8)}", ""
    session.flush()
