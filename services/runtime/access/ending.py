"""Ending of a user's credentials, in every table with credentials or their precursors.

**Conventions.** After `end_all`, the user, or a thief, can sign in only with the password or the provider. It ends
tokens, browser sessions, approved programs that have not fetched their token, mailed links, and team invitations.
`end_browsers` ends browser sessions with the programs that these approved (foreign key); fetched tokens stay. Add every
table with a new kind of secret here (`tests/services/runtime/access/test_ending.py`).
"""

from dataclasses import dataclass

from sqlalchemy import delete, select, update
from sqlalchemy.orm import Session

from services.runtime.access.issuing import token_count
from services.runtime.orm import DeviceGrant, EmailAddress, TeamInvitation, Token, User, WebSession


@dataclass(frozen=True)
class EndedCredentials:
    """The numbers of ended tokens and browser sessions."""

    tokens: int
    browsers: int


def end_all(session: Session, user_id: str, kept_id: str = "") -> EndedCredentials:
    """End all credentials of a user except `kept_id`, which ends too if another of them created it."""
    browsers = end_browsers(session, user_id, kept_id)
    before = token_count(session, user_id)
    session.execute(delete(Token).where(Token.user_id == user_id, Token.id != kept_id))
    session.execute(delete(DeviceGrant).where(DeviceGrant.user_id == user_id))
    session.execute(
        delete(TeamInvitation).where(TeamInvitation.created_by == user_id, TeamInvitation.used_by.is_(None))
    )
    session.execute(update(EmailAddress).where(EmailAddress.user_id == user_id).values(secret_hash="", expires_ns=0))
    return EndedCredentials(before - token_count(session, user_id), browsers)


def end_browsers(session: Session, user_id: str, kept_id: str = "") -> int:
    """Sign a user out of every browser except the session `kept_id`; return the number of browsers."""
    session.execute(select(User.id).where(User.id == user_id).with_for_update())  # blocks issuing
    others = delete(WebSession).where(WebSession.user_id == user_id, WebSession.id != kept_id)
    return len(session.scalars(others.returning(WebSession.id)).all())
