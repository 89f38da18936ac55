"""Routes for administrators: create, list, change and erase users; every act is audited with its reason."""

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query

from api import audit
from api.answers import refusals
from api.deps import Caller, PlatformDep, require
from api.errors import NotFoundError
from api.paging import Page, PageDep
from api.schemas.admin import ReasonBody
from api.schemas.base import PLAIN, IdPath
from api.schemas.people import Password, RevokedItem, TokenItem, UserBody, UserChange, UserItem
from api.views.people import tokens_page, user_item, user_of, users_page
from services.runtime.access import login_throttle, passwords, tokens, users
from services.runtime.access.ending import end_all
from services.runtime.access.erasure import erase_user
from services.runtime.access.roles import Role

router = APIRouter(prefix="/admin/users", tags=["people"])

Administrator = Annotated[Caller, Depends(require("admin", "administrator"))]
NamePart = Annotated[str | None, Query(pattern=PLAIN, max_length=64, description="Part of the name.")]
RoleQuery = Annotated[Role | None, Query()]


@router.post("", status_code=201, summary="Create a user", responses=refusals(409))
def create_user(body: UserBody, caller: Administrator, platform: PlatformDep) -> UserItem:
    password_hash = _hashed(body.password, body.name)
    with platform.database.transaction() as session:
        user = users.create_user(session, body.name, body.role)
        user.password_hash = password_hash or ""
        facts = {"name": user.name, "role": user.role}
        audit.record_admin_act(session, caller, "user.add", user.id, body.reason, facts)
    return user_item(user)


@router.get("", summary="List all users, newest first")
def list_users(
    _caller: Administrator, query: PageDep, platform: PlatformDep, name: NamePart = None, role: RoleQuery = None
) -> Page[UserItem]:
    with platform.database.reading() as session:
        return users_page(session, query, name, role)


@router.patch("/{user_id}", summary="Change a user's role, password or access", responses=refusals(404, 409))
def change_user(user_id: IdPath, body: UserChange, caller: Administrator, platform: PlatformDep) -> UserItem:
    with platform.database.reading() as session:
        name = user_of(session, user_id).name
    password_hash = _hashed(body.password, name)
    with platform.database.transaction() as session:
        user = user_of(session, user_id, is_locked=True)
        users.change_user(session, user, body.role, body.is_active)
        if password_hash is not None:
            users.change_password(session, user, password_hash)
            login_throttle.forgive_name(session, user.name)
        audit.record_admin_act(session, caller, "user.change", user_id, body.reason, _changes(body))
    return user_item(user)


@router.post(
    "/{user_id}/erase", name="erase_user", summary="Erase a user's account permanently", responses=refusals(404, 409)
)
def erase(user_id: IdPath, body: ReasonBody, caller: Administrator, platform: PlatformDep) -> UserItem:
    """Delete name, password, tokens and sessions at once. The user's data stay, without a name."""
    with platform.database.transaction() as session:
        user = user_of(session, user_id, is_locked=True)
        erase_user(session, user)
        audit.record_admin_act(session, caller, "user.erase", user_id, body.reason)
    return user_item(user)


@router.get("/{user_id}/tokens", summary="List a user's tokens, newest first", responses=refusals(404))
def list_user_tokens(user_id: IdPath, _caller: Administrator, query: PageDep, platform: PlatformDep) -> Page[TokenItem]:
    with platform.database.reading() as session:
        return tokens_page(session, query, user_of(session, user_id).id)


@router.post(
    "/{user_id}/tokens/{token_id}/revoke", status_code=204, summary="Revoke a user's token", responses=refusals(404)
)
def revoke_user_token(
    user_id: IdPath, token_id: IdPath, body: ReasonBody, caller: Administrator, platform: PlatformDep
) -> None:
    """Revoke the token, so that requests with it return 401."""
    with platform.database.transaction() as session:
        name = tokens.revoke(session, user_id, token_id)
        if name is None:
            raise NotFoundError("token", token_id)
        facts = {"token_id": token_id, "name": name}
        audit.record_admin_act(session, caller, "user.token_revoke", user_id, body.reason, facts)


@router.post(
    "/{user_id}/credentials/revoke", summary="Revoke all tokens and sessions of a user", responses=refusals(404)
)
def revoke_user_credentials(
    user_id: IdPath, body: ReasonBody, caller: Administrator, platform: PlatformDep
) -> RevokedItem:
    """Revoke them, so that requests with them return 401. The calling credential and the password stay.

    If another token created the calling token, both end. Approved programs that have not fetched their token get none.
    Unused invitations into teams and links in e-mails end too.
    """
    with platform.database.transaction() as session:
        user_of(session, user_id, is_locked=True)
        ended = end_all(session, user_id, caller.credential_id)
        facts = {"tokens": ended.tokens, "browsers": ended.browsers}
        audit.record_admin_act(session, caller, "user.credentials_revoke", user_id, body.reason, facts)
    return RevokedItem(tokens=ended.tokens, browsers=ended.browsers)


def _hashed(password: Password | None, name: str) -> str | None:
    """Return the hash of the password; slow, so it must run before the transaction."""
    return None if password is None else passwords.hash_password(password.get_secret_value(), name)


def _changes(body: UserChange) -> dict[str, Any]:
    """Return the changed fields, without the value of a password."""
    changes = body.model_dump(include={"role", "is_active"}, exclude_none=True)
    return changes | ({"password": "changed"} if body.password is not None else {})
