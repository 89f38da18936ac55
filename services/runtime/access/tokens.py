"""API tokens: issued once, stored and found by their hash.

**Conventions.** A secret is `stone_` and 32 random bytes in base64url. Its sha256 is enough as a hash: 256 random bits
cannot be guessed, so no slow hash is needed and a lookup is one indexed read. A token that another one made ends no
later than that, and is deleted with it (the foreign key says so), whoever deletes it and why.
"""

import re
from collections.abc import Iterable
from hashlib import sha256
from secrets import token_urlsafe

from sqlalchemy import delete, func, select, update
from sqlalchemy.orm import Session

from services.runtime.access.credential_changes import NOTES_USE
from services.runtime.orm import Token, User
from services.runtime.orm.base import now_ns

PREFIX = "stone_"
SECRET = re.compile(r"stone_[A-Za-z0-9_-]{43}")
USED_EVERY_NS = 60 * 10**9


def issue(session: Session, user: User, name: str, scopes: Iterable[str], expires_s: float) -> str:
    """Add a token for `user` and return its secret, which cannot be shown again."""
    return issue_row(session, user, name, scopes, expires_s)[1]


def issue_row(session: Session, user: User, name: str, scopes: Iterable[str], expires_s: float) -> tuple[Token, str]:
    """The token's row beside its secret."""
    return issue_until(session, user, name, scopes, now_ns() + int(expires_s * 1e9))


def issue_until(
    session: Session, user: User, name: str, scopes: Iterable[str], expires_ns: int, parent: Token | None = None
) -> tuple[Token, str]:
    """A token that ends at an instant, and with its `parent` where it has one: its row and its secret."""
    secret = PREFIX + token_urlsafe(32)
    row = Token(user_id=user.id, name=name, scopes=sorted(set(scopes)), expires_ns=expires_ns)
    row.secret_hash, row.parent_id = hash_of(secret), parent.id if parent else None
    session.add(row)
    session.flush()
    return row, secret


def lock_parent(session: Session, token_id: str) -> Token | None:
    """The token, which nobody deletes until the end of the transaction; None where somebody has."""
    kept = select(Token).where(Token.id == token_id).with_for_update(read=True, key_share=True, of=Token)
    return session.scalars(kept).one_or_none()


def find(session: Session, secret: str) -> Token | None:
    """The token of this secret, if it has not expired and its user is active."""
    if not SECRET.fullmatch(secret):
        return None
    row = session.scalars(select(Token).where(Token.secret_hash == hash_of(secret))).one_or_none()
    return row if row and row.user.is_active and row.expires_ns > now_ns() else None


def is_use_due(token: Token) -> bool:
    """Whether its last use is worth writing: at most once a minute."""
    return token.used_ns is None or abs(now_ns() - token.used_ns) >= USED_EVERY_NS


def note_use(session: Session, token_id: str) -> None:
    """Write that the token is used now."""
    used = update(Token).where(Token.id == token_id).values(used_ns=now_ns())
    session.execute(used, execution_options=NOTES_USE)


def revoke(session: Session, user_id: str, token_id: str) -> str | None:
    """End a token of a user with all that it made: the name it had, None where they have no such token."""
    own = delete(Token).where(Token.id == token_id, Token.user_id == user_id).returning(Token.name)
    return session.scalars(own).one_or_none()


def revoke_others(session: Session, user_id: str, kept_id: str) -> int:
    """End every token of a user but that of `kept_id`; how many those were.

    A kept one that one of them made ends too: what a stolen token made is as good as stolen.
    """
    before = token_count(session, user_id)
    session.execute(delete(Token).where(Token.user_id == user_id, Token.id != kept_id))
    return before - token_count(session, user_id)


def token_count(session: Session, user_id: str) -> int:
    return session.scalar(select(func.count()).select_from(Token).where(Token.user_id == user_id)) or 0


def hash_of(secret: str) -> str:
    """The stored hash of a secret."""
    return sha256(secret.encode()).hexdigest()
