"""Ending of a user's credentials: every table that can become one is walked here.

**Conventions.** `end_all` leaves nothing by which the user, or a thief, comes in but the password and the provider:
tokens, browsers, approved programs that have not fetched their token, links that were mailed, invitations into teams.
`end_browsers` ends browsers with the programs that these approved (the foreign key); tokens that were fetched stay. A
table with a new kind of secret belongs here (`tests/services/runtime/access/test_ending.py`).
"""

from dataclasses import dataclass

from sqlalchemy import delete, select, update
from sqlalchemy.orm import Session

from services.runtime.access.issuing import token_count
from services.runtime.orm import DeviceGrant, EmailAddress, TeamInvitation, Token, User, WebSession


@dataclass(frozen=True)
class EndedCredentials:
    """How many tokens and browser sessions ended."""

    tokens: int
    browsers: int


def end_all(session: Session, user_id: str, kept_id: str = "") -> EndedCredentials:
    """End all credentials of a user but the one of `kept_id`, which ends too if one of the others made it."""
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
    """Sign a user out of every browser but the one whose session is `kept_id`; return how many browsers."""
    session.execute(select(User.id).where(User.id == user_id).with_for_update())  # nobody issues meanwhile
    others = delete(WebSession).where(WebSession.user_id == user_id, WebSession.id != kept_id)
    return len(session.scalars(others.returning(WebSession.id)).all())
