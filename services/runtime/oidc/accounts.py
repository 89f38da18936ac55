"""The account of a user who signs in by a provider: selected by issuer and subject, created at the first sign-in.

**Conventions.** A name or an e-mail address proves no identity: an account of the same name belongs to another user,
and a new user gets a free name. Only with `links_verified_email` does the owner of a verified e-mail address get the
account of that name, unless it is an administrator's or linked already.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from hashlib import sha256
from itertools import count
from typing import Any

from sqlalchemy import exists, select, text
from sqlalchemy.orm import Session

from services.runtime.access.roles import Role
from services.runtime.access.users import NAME, change_user, create_user, find_user
from services.runtime.oidc.provider import VerifiedIdentity
from services.runtime.oidc.settings import OidcSettings, groups_in
from services.runtime.orm import ExternalIdentity, User
from services.runtime.orm.base import now_ns
from stone.errors import Refused

LOCK = 0x4F494443  # "OIDC": the number of the advisory lock that serialises first sign-ins
LONGEST_BASE = 56


@dataclass(frozen=True)
class AdmittedUser:
    """The user, and the changes of this sign-in: `is_new`, and the former role if the role changed."""

    user: User
    is_new: bool
    role_before: str


def admit(session: Session, identity: VerifiedIdentity, settings: OidcSettings) -> AdmittedUser:
    """Return the active user of this identity, in the role of their groups.

    Raises `not_admitted`, `account_deactivated`, `last_administrator`.
    """
    role = role_of(identity.claims, settings)
    _lock_sign_ins(session)
    known = session.get(ExternalIdentity, _key(identity))
    if known is not None:
        known.used_ns = now_ns()
        return _in_role(session, known.user, role)
    if (owned := _by_email(session, identity.claims, settings)) is not None:
        _remember(session, identity, owned)
        return _in_role(session, owned, role)
    name = free_name(session, identity, settings.name_claim)
    user = create_user(session, name, role or "participant")
    _remember(session, identity, user)
    return AdmittedUser(user, is_new=True, role_before=user.role)


def role_of(claims: Mapping[str, Any], settings: OidcSettings) -> Role | None:
    """Return the highest role of a user's groups; None if only the platform assigns roles.

    Raises `not_admitted` for a user without an admitted group, if admission is limited.
    """
    groups = _groups(claims, settings.groups_claim)
    administrators, curators = groups_in(settings.administrators), groups_in(settings.curators)
    if groups & administrators:
        return "administrator"
    if groups & curators:
        return "curator"
    admitted = groups_in(settings.participants)
    if admitted and not groups & admitted:
        raise Refused(
            "not_admitted",
            f"none of your groups (the claim {settings.groups_claim!r}) is admitted here; ask an administrator "
            "for a group that is",
        )
    return "participant" if administrators or curators else None


def free_name(session: Session, identity: VerifiedIdentity, claim: str) -> str:
    """Return the claim as a valid name, with a number if the name is taken."""
    return next(name for name in _names(identity, claim) if find_user(session, name) is None)


def _names(identity: VerifiedIdentity, claim: str) -> Iterator[str]:
    value = identity.claims.get(claim)
    base = re.sub(r"[^a-z0-9._@+-]+", "-", value.lower()).strip("-")[:LONGEST_BASE] if isinstance(value, str) else ""
    base = base if NAME.fullmatch(base) else f"user-{_key(identity)[:12]}"
    yield base
    yield from (f"{base}-{number}" for number in range(2, 100))
    yield from (f"user-{_key(identity)[: 12 + more]}" for more in count(0, 4))


def _in_role(session: Session, user: User, role: Role | None) -> AdmittedUser:
    if not user.is_active:
        raise Refused(
            "account_deactivated", f"the account {user.name!r} is deactivated; ask an administrator of the platform"
        )
    before = user.role
    if role is not None and role != before:
        change_user(session, user, role, None)
    return AdmittedUser(user, is_new=False, role_before=before)


def _by_email(session: Session, claims: Mapping[str, Any], settings: OidcSettings) -> User | None:
    email = claims.get("email")
    if not (settings.links_verified_email and claims.get("email_verified") is True and isinstance(email, str)):
        return None
    user = find_user(session, email.lower()) if "@" in email else None
    if user is None or user.role == "administrator":
        return None
    is_taken = session.scalar(select(exists().where(ExternalIdentity.user_id == user.id)))
    return None if is_taken else user


def _remember(session: Session, identity: VerifiedIdentity, user: User) -> None:
    row = ExternalIdentity(key=_key(identity), issuer=identity.issuer, subject=identity.subject, user_id=user.id)
    session.add(row)
    session.flush()


def _groups(claims: Mapping[str, Any], name: str) -> frozenset[str]:
    value = claims.get(name)
    listed = value if isinstance(value, list) else [value]
    return frozenset(group for group in listed if isinstance(group, str))


def _lock_sign_ins(session: Session) -> None:
    """Lock, so that two concurrent first sign-ins create one account; on SQLite a write transaction is a lock."""
    if session.get_bind().dialect.name == "postgresql":
        session.execute(text("SELECT pg_advisory_xact_lock(:number)"), {"number": LOCK})


def _key(identity: VerifiedIdentity) -> str:
    return sha256(f"{identity.issuer}\n{identity.subject}".encode()).hexdigest()
