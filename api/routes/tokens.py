"""Routes of API tokens: issue, list, revoke.

**Conventions.** A token cannot grant what its maker does not hold: neither a scope, nor, when a token makes it, a
longer life. The secret is in the answer to its making and nowhere else.
"""

from typing import Annotated

from fastapi import APIRouter, Depends, Response
from sqlalchemy import delete
from sqlalchemy.orm import Session

from api import audit
from api.answers import refusals
from api.deps import Caller, PlatformDep, require
from api.errors import ConflictError, ForbiddenError, NotFoundError
from api.paging import Page, PageDep
from api.schemas.base import IdPath
from api.schemas.people import IssuedToken, TokenBody, TokenItem
from api.views.people import token_item, tokens_page
from services.runtime.access import tokens, users
from services.runtime.orm import Token, User
from services.runtime.orm.base import now_ns

router = APIRouter(prefix="/tokens", tags=["people"])

MOST_TOKENS = 200

Anybody = Annotated[Caller, Depends(require("read"))]


@router.post("", status_code=201, summary="Issue a token of one's own", responses=refusals(409))
def issue(body: TokenBody, caller: Anybody, response: Response, platform: PlatformDep) -> IssuedToken:
    """The answer holds the secret and is kept nowhere: repeated under the same Idempotency-Key, it is a 409."""
    scopes = caller.scopes if body.scopes is None else frozenset[str](body.scopes)
    _refuse_more(scopes, caller)
    expires_ns = _end_ns(body, caller, platform.settings.api.token_s)
    with platform.database.transaction() as session:
        _refuse_too_many(session, caller)
        owner = session.get_one(User, caller.user_id)
        row, secret = tokens.issue_until(session, owner, body.name, scopes, expires_ns)
        audit.record(session, caller, "token.issue", row.id, facts={"scopes": row.scopes, "name": row.name})
    response.headers["Cache-Control"] = "no-store"
    return IssuedToken(**token_item(row).model_dump(), secret=secret)


@router.get("", summary="One's own tokens, newest first")
def listed(caller: Anybody, query: PageDep, platform: PlatformDep) -> Page[TokenItem]:
    with platform.database.reading() as session:
        return tokens_page(session, query, caller.user_id)


@router.delete("/{token_id}", status_code=204, summary="Revoke a token of one's own", responses=refusals(404))
def revoke(token_id: IdPath, caller: Anybody, platform: PlatformDep) -> None:
    with platform.database.transaction() as session:
        own = delete(Token).where(Token.id == token_id, Token.user_id == caller.user_id).returning(Token.id)
        if session.execute(own).first() is None:
            raise NotFoundError("token", token_id)
        audit.record(session, caller, "token.revoke", token_id)


def _refuse_more(scopes: frozenset[str], caller: Caller) -> None:
    if not scopes <= caller.scopes:
        beyond = sorted(scopes - caller.scopes)
        raise ForbiddenError(f"you cannot grant {beyond}; yours are {sorted(caller.scopes)}")


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
    if users.token_count(session, caller.user_id) >= MOST_TOKENS:
        raise ConflictError(f"you have {MOST_TOKENS} tokens already; revoke those that are not used")
