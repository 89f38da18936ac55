"""Who is signed in, by cookie."""

from api.middleware.context import COOKIE
from services.runtime.access import sessions
from services.runtime.orm import User
from services.runtime.platform import Platform
from testing.api.serving import Person


def secret_of(platform: Platform, who: Person) -> str:
    """The secret of a new session of this person."""
    with platform.database.transaction() as session:
        return sessions.open_session(session, session.get_one(User, who.user_id), 3600.0).secret


def cookie(platform: Platform, who: Person | None) -> dict[str, str]:
    """The header of a browser that is signed in; of a visitor's, none."""
    return {} if who is None else {"Cookie": f"{COOKIE}={secret_of(platform, who)}"}
