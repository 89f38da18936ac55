"""Issuing of credentials: the only module that creates tokens and browser sessions, each by an authority.

**Conventions.** An `Authority` has the user that authorises a credential, and its limits. A person who proved their
identity (password, provider) authorises a browser session. A browser session authorises programs: their tokens may have
the longest lifetime, and outlive the session. A token authorises tokens that have no scope beyond its own, end no
later, and are deleted with it (foreign key). `ending` ends all of them. Issuing locks the user's row first, and ending
locks it exclusively, so that nothing is issued while everything ends.
"""

from dataclasses import dataclass
from hashlib import sha256
from secrets import token_urlsafe
from typing import TypeVar

from sqlalchemy import delete, func, select
from sqlalchemy.orm import Session

from services.runtime.access.roles import ACCOUNT, SCOPES, SCOPES_OF, scopes_in_force
from services.runtime.orm import Token, User, WebSession
from services.runtime.orm.base import now_ns
from stone.errors import Refused

PREFIX = "stone_"
MOST_TOKENS = 200

Credential = TypeVar("Credential", Token, WebSession)


@dataclass(frozen=True)
class Authority:
    """The source of a credential: the user, their scopes, its latest end, and the token that it ends with."""

    user_id: str
    scopes: frozenset[str]
    latest_ns: int
    parent_id: str | None = None


@dataclass(frozen=True)
class TokenRequest:
    """The requested token; None means all scopes of the authority except `account`, and the latest end."""

    name: str
    scopes: frozenset[str] | None = None
    expires_s: float | None = None


@dataclass(frozen=True)
class SessionSecrets:
    """The secrets of a browser session: the cookie, and the token that scripts repeat in `X-CSRF-Token`."""

    secret: str
    csrf_token: str
    expires_ns: int


def authority_for(user: User, lasts_s: float) -> Authority:
    """Return the platform's authority, for a user who just proved their identity or is given by the operator."""
    return Authority(user.id, frozenset(SCOPES), now_ns() + int(lasts_s * 1e9))


def authority_of_token(session: Session, token_id: str, longest_s: float) -> Authority | None:
    """Return the authority of a token; None if it has ended. It cannot end before the transaction does."""
    row = _standing(session, Token, token_id)
    if row is None:
        return None
    latest_ns = min(now_ns() + int(longest_s * 1e9), row.expires_ns)
    return Authority(row.user_id, scopes_in_force(row.user.role, row.scopes), latest_ns, row.id)


def authority_of_session(session: Session, session_id: str, longest_s: float) -> Authority | None:
    """Return the authority of a browser's session, whose end limits no token; None if it has ended."""
    row = _standing(session, WebSession, session_id)
    if row is None:
        return None
    return Authority(row.user_id, SCOPES_OF[row.user.role], now_ns() + int(longest_s * 1e9))


def lock_user(session: Session, user_id: str) -> User:
    """Return the user's current row, locked: their credentials cannot end before the transaction does."""
    locked = select(User).where(User.id == user_id).with_for_update(read=True, key_share=True)
    return session.scalars(locked.execution_options(populate_existing=True)).one()


def issue_token(session: Session, authority: Authority, wanted: TokenRequest) -> tuple[Token, str]:
    """Create a token; return its row and its secret, which cannot be shown again.

    Raises `forbidden`, `account_deactivated`.
    """
    scopes, expires_ns = _granted_scopes(authority, wanted), _granted_end_ns(authority, wanted)
    secret = PREFIX + token_urlsafe(32)
    row = Token(user_id=_active_user(session, authority).id, name=wanted.name, scopes=scopes, expires_ns=expires_ns)
    row.secret_hash, row.parent_id = hash_of(secret), authority.parent_id
    session.add(row)
    session.flush()
    return row, secret


def open_session(session: Session, authority: Authority) -> SessionSecrets:
    """Sign a browser in, and delete the user's expired sessions. Raises `account_deactivated`."""
    user_id = _active_user(session, authority).id
    session.execute(delete(WebSession).where(WebSession.user_id == user_id, WebSession.expires_ns <= now_ns()))
    opened = SessionSecrets(token_urlsafe(32), token_urlsafe(32), authority.latest_ns)
    row = WebSession(user_id=user_id, csrf_token=opened.csrf_token, expires_ns=opened.expires_ns)
    row.secret_hash = hash_of(opened.secret)
    session.add(row)
    session.flush()
    return opened


def refuse_too_many(session: Session, user_id: str) -> None:
    """Raise `conflict` if the user has `MOST_TOKENS` tokens."""
    if token_count(session, user_id) >= MOST_TOKENS:
        raise Refused("conflict", f"you have {MOST_TOKENS} tokens already; revoke unused tokens")


def token_count(session: Session, user_id: str) -> int:
    return session.scalar(select(func.count()).select_from(Token).where(Token.user_id == user_id)) or 0


def hash_of(secret: str) -> str:
    """Return the stored hash of a secret. 256 random bits cannot be guessed, so no slow hash is needed."""
    return sha256(secret.encode()).hexdigest()


def _standing(session: Session, kind: type[Credential], credential_id: str) -> Credential | None:
    """Return the credential, locked after its user; None if it has ended."""
    user_id = session.scalar(select(kind.user_id).where(kind.id == credential_id))
    if user_id is None:
        return None
    lock_user(session, user_id)
    locked = select(kind).where(kind.id == credential_id).with_for_update(read=True, key_share=True, of=kind)
    row = session.scalars(locked.execution_options(populate_existing=True)).one_or_none()
    return row if row and row.expires_ns > now_ns() and row.user.is_active else None


def _active_user(session: Session, authority: Authority) -> User:
    user = lock_user(session, authority.user_id)
    if not user.is_active:
        raise Refused(
            "account_deactivated", f"the account {user.name!r} is deactivated; ask an administrator of the platform"
        )
    return user


def _granted_scopes(authority: Authority, wanted: TokenRequest) -> list[str]:
    scopes = authority.scopes - {ACCOUNT} if wanted.scopes is None else wanted.scopes
    if not scopes:
        raise Refused("forbidden", "a token has the scope 'account' only if the request names it; add it to scopes")
    if not scopes <= authority.scopes:
        beyond = sorted(scopes - authority.scopes)
        raise Refused("forbidden", f"you cannot grant {beyond}; your scopes are {sorted(authority.scopes)}")
    return sorted(scopes)


def _granted_end_ns(authority: Authority, wanted: TokenRequest) -> int:
    if wanted.expires_s is None:
        return authority.latest_ns
    now = now_ns()
    if now + int(wanted.expires_s * 1e9) > authority.latest_ns:
        left_s = (authority.latest_ns - now) / 1e9
        raise Refused("forbidden", f"this token may last {left_s:.0f} s at most, not {wanted.expires_s:.0f} s")
    return now + int(wanted.expires_s * 1e9)
