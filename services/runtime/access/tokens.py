"""API tokens: lookup by the hash of their secret, and revocation; `issuing` creates them.

**Conventions.** A secret is `stone_` and 32 random bytes in base64url; a lookup is one indexed read of its sha256.
"""

import re
from collections.abc import Iterable

from sqlalchemy import delete, select, update
from sqlalchemy.orm import Session

from services.runtime.access.credential_changes import NOTES_USE
from services.runtime.access.issuing import TokenRequest, authority_for, hash_of, issue_token
from services.runtime.orm import Token, User
from services.runtime.orm.base import now_ns

SECRET = re.compile(r"stone_[A-Za-z0-9_-]{43}")
USED_EVERY_NS = 60 * 10**9


def issue(session: Session, user: User, name: str, scopes: Iterable[str], expires_s: float) -> str:
    """Return the secret of a new token that the platform creates for `user`, on its first start or by its operator."""
    return issue_token(session, authority_for(user, expires_s), TokenRequest(name, frozenset(scopes)))[1]


def find(session: Session, secret: str) -> Token | None:
    """Return the unexpired token with this secret, if its user is active."""
    if not SECRET.fullmatch(secret):
        return None
    row = session.scalars(select(Token).where(Token.secret_hash == hash_of(secret))).one_or_none()
    return row if row and row.user.is_active and row.expires_ns > now_ns() else None


def is_use_due(token: Token) -> bool:
    """Return whether its last use should be written: at most once a minute."""
    return token.used_ns is None or abs(now_ns() - token.used_ns) >= USED_EVERY_NS


def note_use(session: Session, token_id: str) -> None:
    """Write that the token is in use."""
    used = update(Token).where(Token.id == token_id).values(used_ns=now_ns())
    session.execute(used, execution_options=NOTES_USE)


def revoke(session: Session, user_id: str, token_id: str) -> str | None:
    """End a token of a user and all tokens it created; return its name, or None if the user has no such token."""
    own = delete(Token).where(Token.id == token_id, Token.user_id == user_id).returning(Token.name)
    return session.scalars(own).one_or_none()
