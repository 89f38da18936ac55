"""Signed-in users, by cookie."""

from api.middleware.context import COOKIE
from services.runtime.access import sessions
from services.runtime.orm import User
from services.runtime.platform import Platform
from testing.api.serving import Person


def secret_of(platform: Platform, who: Person) -> str:
    """Return the secret of a new session of this person."""
    with platform.database.transaction() as session:
        return sessions.open_session(session, session.get_one(User, who.user_id), 3600.0).secret


def cookie(platform: Platform, who: Person | None) -> dict[str, str]:
    """Return the header of a signed-in browser; for a visitor, none."""
    return {} if who is None else {"Cookie": f"{COOKIE}={secret_of(platform, who)}"}
