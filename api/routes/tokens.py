"""Routes of API tokens: issue, list, revoke.

**Conventions.** A token cannot grant what its maker does not hold: neither a scope, nor, when a token makes it, a
longer life; and it ends when its maker is revoked. To issue and revoke tokens needs the scope `account`, which a
browser's session has; any token may end itself. The secret is in the answer to its making and nowhere else.
"""

from fastapi import APIRouter, Response
from sqlalchemy.orm import Session

from api import audit
from api.answers import refusals
from api.deps import AccountHolder, Anybody, Caller, PlatformDep, Reader
from api.errors import ApiError, ForbiddenError, NotFoundError, UnauthenticatedError
from api.paging import Page, PageDep
from api.schemas.base import IdPath
from api.schemas.people import IssuedToken, TokenBody, TokenItem
from api.views.people import tokens_page
from services.runtime.access import tokens
from services.runtime.access.roles import ACCOUNT
from services.runtime.orm import Token, User
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform

router = APIRouter(prefix="/tokens", tags=["people"])

MOST_TOKENS = 200


@router.post("", status_code=201, summary="Issue a token of one's own", responses=refusals(409))
def issue(body: TokenBody, caller: AccountHolder, response: Response, platform: PlatformDep) -> IssuedToken:
    """The answer holds the secret and is kept nowhere: repeated under the same Idempotency-Key, it is a 409."""
    scopes = _scopes(body, caller)
    expires_ns = _end_ns(body, caller, platform.settings.api.token_s)
    with platform.database.transaction() as session:
        _refuse_too_many(session, caller)
        owner = session.get_one(User, caller.user_id)
        row, secret = tokens.issue_until(session, owner, body.name, scopes, expires_ns, _parent(session, caller))
        audit.record(session, caller, "token.issue", row.id, facts={"scopes": row.scopes, "name": row.name})
    response.headers["Cache-Control"] = "no-store"
    return IssuedToken.of(row, secret=secret)


@router.get("", summary="One's own tokens, newest first")
def listed(caller: Reader, query: PageDep, platform: PlatformDep) -> Page[TokenItem]:
    with platform.database.reading() as session:
        return tokens_page(session, query, caller.user_id)


@router.delete("/current", status_code=204, summary="Revoke the token that asks", responses=refusals(409))
def revoke_current(caller: Anybody, platform: PlatformDep) -> None:
    """Whatever its scopes are; with it goes all that it made."""
    if caller.is_session:
        raise ApiError("conflict", "a session is no token; sign out by DELETE /sessions/current")
    _revoke(platform, caller, caller.credential_id)


@router.delete("/{token_id}", status_code=204, summary="Revoke a token of one's own", responses=refusals(404))
def revoke(token_id: IdPath, caller: AccountHolder, platform: PlatformDep) -> None:
    """With it goes all that it made."""
    _revoke(platform, caller, token_id)


def _revoke(platform: Platform, caller: Caller, token_id: str) -> None:
    """Raises `NotFoundError`."""
    with platform.database.transaction() as session:
        if tokens.revoke(session, caller.user_id, token_id) is None:
            raise NotFoundError("token", token_id)
        audit.record(session, caller, "token.revoke", token_id)


def _scopes(body: TokenBody, caller: Caller) -> frozenset[str]:
    """Those that are asked for, else all of the caller's but `account`. Raises `ForbiddenError`."""
    scopes = caller.scopes - {ACCOUNT} if body.scopes is None else frozenset[str](body.scopes)
    if not scopes:
        raise ForbiddenError("a token has the scope 'account' only where it is asked for; name it in scopes")
    if not scopes <= caller.scopes:
        beyond = sorted(scopes - caller.scopes)
        raise ForbiddenError(f"you cannot grant {beyond}; yours are {sorted(caller.scopes)}")
    return scopes


def _parent(session: Session, caller: Caller) -> Token | None:
    """The token that asks; None for a browser. Raises `UnauthenticatedError` where it was revoked meanwhile."""
    if caller.is_session:
        return None
    parent = tokens.lock_parent(session, caller.credential_id)
    if parent is None:
        raise UnauthenticatedError("the token was revoked")
    return parent


def _end_ns(body: TokenBody, caller: Caller, longest_s: float) -> int:
    """As late as asked, else as late as allowed. Raises `ForbiddenError` beyond that."""
    now = now_ns()
    latest_ns = now + int(longest_s * 1e9)
    if not caller.is_session:
        latest_ns = min(latest_ns, caller.expires_ns)
    if body.expires_s is None:
        return latest_ns
    if now + int(body.expires_s * 1e9) > latest_ns:
        left_s = (latest_ns - now) / 1e9
        raise ForbiddenError(f"this token may last {left_s:.0f} s at most, not {body.expires_s:.0f} s")
    return now + int(body.expires_s * 1e9)


def _refuse_too_many(session: Session, caller: Caller) -> None:
    if tokens.token_count(session, caller.user_id) >= MOST_TOKENS:
        raise ApiError("conflict", f"you have {MOST_TOKENS} tokens already; revoke those that are not used")
