"""Users, for administrators: made, listed, changed; each act with its reason in the audit log."""

from typing import Annotated, Any

from fastapi import APIRouter, Depends
from sqlalchemy import select

from api import audit
from api.answers import refusals
from api.deps import Caller, PlatformDep, require
from api.errors import NotFoundError
from api.paging import Page, PageDep, page
from api.schemas.base import IdPath, instant
from api.schemas.people import Password, UserBody, UserChange, UserItem
from services.runtime.access import passwords, users
from services.runtime.orm import User

router = APIRouter(prefix="/users", tags=["people"])

Administrator = Annotated[Caller, Depends(require("admin", "administrator"))]


@router.post("", status_code=201, summary="Add a user", responses=refusals(409))
def add(body: UserBody, caller: Administrator, platform: PlatformDep) -> UserItem:
    password_hash = _hashed(body.password)
    with platform.database.transaction() as session:
        user = users.create_user(session, body.name, body.role)
        user.password_hash = password_hash or ""
        facts = {"name": user.name, "role": user.role}
        audit.record_admin_act(session, caller, "user.add", user.id, body.reason, facts)
    return _shown(user)


@router.get("", summary="All users, newest first")
def listed(_caller: Administrator, query: PageDep, platform: PlatformDep) -> Page[UserItem]:
    with platform.database.reading() as session:
        return page(session, select(User), User.id.desc(), query).shown(_shown)


@router.patch("/{user_id}", summary="Change a user's role, password or access", responses=refusals(404, 409))
def change(user_id: IdPath, body: UserChange, caller: Administrator, platform: PlatformDep) -> UserItem:
    password_hash = _hashed(body.password)
    with platform.database.transaction() as session:
        user = session.get(User, user_id, with_for_update=True)
        if user is None:
            raise NotFoundError("user", user_id)
        users.change_user(session, user, body.role, body.is_active)
        if password_hash is not None:
            users.change_password(session, user, password_hash)
        audit.record_admin_act(session, caller, "user.change", user_id, body.reason, _changes(body))
    return _shown(user)


def _hashed(password: Password | None) -> str | None:
    """Slow, so before the transaction."""
    return None if password is None else passwords.hash_password(password.get_secret_value())


def _changes(body: UserChange) -> dict[str, Any]:
    """What was asked for; of a password only that there was one."""
    changes = body.model_dump(include={"role", "is_active"}, exclude_none=True)
    return changes | ({"password": "changed"} if body.password is not None else {})


def _shown(row: User) -> UserItem:
    facts: dict[str, Any] = {"has_password": bool(row.password_hash), "created_at": instant(row.created_ns)}
    return UserItem(id=row.id, name=row.name, role=row.role, is_active=row.is_active, **facts)
