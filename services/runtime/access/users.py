"""Users: created, found, changed.

**Conventions.** A name is [a-z0-9._@+-]{1,64}: it appears in logs and on pages and must not be mistaken for markup, for
a path or for another name in capitals. A user is never deleted, only deactivated, because ledgers refer to users.
"""

import re

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.access.ending import end_all, end_browsers
from services.runtime.access.errors import name_taken
from services.runtime.access.login_throttle import forget_addresses
from services.runtime.access.passwords import hash_password
from services.runtime.access.roles import ROLES
from services.runtime.orm import User
from stone.errors import Refused

NAME = re.compile(r"[a-z0-9._@+-]{1,64}")


def create_user(session: Session, name: str, role: str, password: str | None = None) -> User:
    """Add an active user; without a password the user can only have tokens.

    Raises `bad_name`, `unknown_role`, `weak_password`, `name_taken`.
    """
    if not NAME.fullmatch(name):
        raise Refused(
            "bad_name", f"{name[:80]!r} is not a valid user name; use 1 to 64 of a-z, 0-9, '.', '_', '-', '@', '+'"
        )
    _refuse_unknown(role)
    password_hash = hash_password(password) if password is not None else ""
    if find_user(session, name) is not None:
        raise name_taken("user", name)
    user = User(name=name, role=role, password_hash=password_hash, is_active=True)
    session.add(user)
    session.flush()
    return user


def find_user(session: Session, name: str) -> User | None:
    """Return the user with that name, active or not."""
    return session.scalars(select(User).where(User.name == name)).one_or_none()


def change_user(session: Session, user: User, role: str | None, is_active: bool | None) -> None:
    """Change the role; reactivate, or deactivate with all credentials. Raises `unknown_role`, `last_administrator`."""
    if role is not None:
        _refuse_unknown(role)
    loses = (role is not None and role != "administrator") or is_active is False
    if loses and user.role == "administrator" and user.is_active and not _others(session, user):
        raise Refused(
            "last_administrator",
            f"{user.name!r} is the last active administrator; make another user an administrator first",
        )
    user.role = user.role if role is None else role
    user.is_active = user.is_active if is_active is None else is_active
    session.flush()
    if is_active is False:
        end_all(session, user.id)


def change_password(session: Session, user: User, password_hash: str) -> None:
    """Set the hash of a new password, sign out every browser, and forget the user's known addresses.

    Approved programs that have not fetched their token get none.
    """
    user.password_hash = password_hash
    session.flush()
    forget_addresses(session, user.id)
    end_browsers(session, user.id)


def _others(session: Session, user: User) -> list[User]:
    """Return the other active administrators, locked, so that two cannot demote each other concurrently."""
    active = select(User).where(User.role == "administrator", User.is_active).order_by(User.id).with_for_update()
    return [other for other in session.scalars(active).all() if other.id != user.id]


def _refuse_unknown(role: str) -> None:
    if role not in ROLES:
        raise Refused("unknown_role", f"there is no role {role[:80]!r}; the roles are {', '.join(ROLES)}")
