"""Routes of API tokens: issue, list, revoke.

**Conventions.** `services/runtime/access/issuing.py` bounds what a caller may grant. Issuing and revoking require the
scope `account`, which a browser's session has; any token may revoke itself. Only the answer that creates a token
contains its secret.
"""

from fastapi import APIRouter, Response
from sqlalchemy.orm import Session

from api import audit
from api.answers import refusals
from api.deps import AccountHolder, Anybody, Caller, PlatformDep, Reader
from api.errors import ApiError, NotFoundError, UnauthenticatedError
from api.paging import Page, PageDep
from api.schemas.base import IdPath
from api.schemas.people import IssuedToken, TokenBody, TokenItem
from api.views.people import tokens_page
from services.runtime.access import issuing, tokens
from services.runtime.access.issuing import Authority, TokenRequest
from services.runtime.platform import Platform

router = APIRouter(prefix="/tokens", tags=["people"])


@router.post("", status_code=201, summary="Create a token", responses=refusals(409))
def create_token(body: TokenBody, caller: AccountHolder, response: Response, platform: PlatformDep) -> IssuedToken:
    """Create a token. The response contains the secret and is not stored. A repetition with the same Idempotency-Key
    returns 409.
    """
    wanted = TokenRequest(body.name, None if body.scopes is None else frozenset(body.scopes), body.expires_s)
    with platform.database.transaction() as session:
        authority = authority_of_caller(session, caller, platform.settings.api.token_s)
        issuing.refuse_too_many(session, caller.user_id)
        row, secret = issuing.issue_token(session, authority, wanted)
        audit.record(session, caller, "token.issue", row.id, facts={"scopes": row.scopes, "name": row.name})
    response.headers["Cache-Control"] = "no-store"
    return IssuedToken.of(row, secret=secret)


@router.get("", summary="List your tokens, newest first")
def list_tokens(caller: Reader, query: PageDep, platform: PlatformDep) -> Page[TokenItem]:
    with platform.database.reading() as session:
        return tokens_page(session, query, caller.user_id)


@router.delete("/current", status_code=204, summary="Revoke the calling token", responses=refusals(409))
def revoke_current_token(caller: Anybody, platform: PlatformDep) -> None:
    """Revoke the calling token, which requires no scope, and all tokens that it created."""
    if caller.is_session:
        raise ApiError("conflict", "a session is not a token; sign out with DELETE /sessions/current")
    _revoke(platform, caller, caller.credential_id)


@router.delete("/{token_id}", status_code=204, summary="Revoke one of your tokens", responses=refusals(404))
def revoke_token(token_id: IdPath, caller: AccountHolder, platform: PlatformDep) -> None:
    """Revoke the token and all tokens that it created."""
    _revoke(platform, caller, token_id)


def authority_of_caller(session: Session, caller: Caller, longest_s: float) -> Authority:
    """Return the authority of the caller's credential. Raises `UnauthenticatedError` if it has ended."""
    of_credential = issuing.authority_of_session if caller.is_session else issuing.authority_of_token
    authority = of_credential(session, caller.credential_id, longest_s)
    if authority is None:
        raise UnauthenticatedError("the token or session has ended")
    return authority


def _revoke(platform: Platform, caller: Caller, token_id: str) -> None:
    """Revoke the token. Raises `NotFoundError`."""
    with platform.database.transaction() as session:
        if tokens.revoke(session, caller.user_id, token_id) is None:
            raise NotFoundError("token", token_id)
        audit.record(session, caller, "token.revoke", token_id)
