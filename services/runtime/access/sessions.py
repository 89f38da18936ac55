"""Browser sessions: lookup by the hash of the cookie's secret, and sign-out; `issuing` creates them."""

from sqlalchemy import delete, select, update
from sqlalchemy.orm import Session

from services.runtime.access import issuing
from services.runtime.access.credential_changes import NOTES_USE
from services.runtime.access.issuing import SessionSecrets, authority_for, hash_of
from services.runtime.access.passwords import verify_password
from services.runtime.access.tokens import USED_EVERY_NS
from services.runtime.orm import User, WebSession
from services.runtime.orm.base import now_ns

LONGEST_SECRET = 64


def is_password_of(user: User | None, password: str) -> bool:
    """Return whether this active user has that password. Equally slow for None: hold no transaction meanwhile."""
    is_known = user is not None and user.is_active
    return verify_password(user.password_hash if user and is_known else "", password)


def open_session(session: Session, user: User, lasts_s: float) -> SessionSecrets:
    """Sign in the browser of a user who just proved their identity. Raises `account_deactivated`."""
    return issuing.open_session(session, authority_for(user, lasts_s))


def find_session(session: Session, secret: str, idle_s: float) -> WebSession | None:
    """Return the unexpired session with this cookie, if it was used within `idle_s` and its user is active."""
    if not 0 < len(secret) <= LONGEST_SECRET:
        return None
    row = session.scalars(select(WebSession).where(WebSession.secret_hash == hash_of(secret))).one_or_none()
    now = now_ns()
    is_open = row and row.user.is_active and row.expires_ns > now and row.used_ns > now - int(idle_s * 1e9)
    return row if is_open else None


def is_use_due(row: WebSession) -> bool:
    """Return whether its last use should be written: at most once a minute."""
    return abs(now_ns() - row.used_ns) >= USED_EVERY_NS


def note_use(session: Session, session_id: str) -> None:
    """Write that the session is in use."""
    used = update(WebSession).where(WebSession.id == session_id).values(used_ns=now_ns())
    session.execute(used, execution_options=NOTES_USE)


def close_session(session: Session, session_id: str) -> None:
    session.execute(delete(WebSession).where(WebSession.id == session_id))
