"""Roles and the scopes they allow.

**Conventions.** Roles are ordered: curators may do everything that participants may, administrators everything that
curators may. The scope `account` allows changing one's own credentials: tokens, browser sessions, the password. Every
role allows it, and a token has it only on explicit request.
"""

from collections.abc import Iterable
from typing import Literal

Role = Literal["participant", "curator", "administrator"]
Scope = Literal["read", "upload", "submit", "admin", "account"]

ROLES: tuple[Role, ...] = ("participant", "curator", "administrator")
SCOPES: tuple[Scope, ...] = ("read", "upload", "submit", "admin", "account")
ACCOUNT: Scope = "account"
SCOPES_OF: dict[str, frozenset[str]] = {
    "participant": frozenset({"read", "submit", ACCOUNT}),
    "curator": frozenset({"read", "submit", "upload", ACCOUNT}),
    "administrator": frozenset({"read", "submit", "upload", "admin", ACCOUNT}),
}


def rank(role: str) -> int:
    """Return 0 for a participant, increasing with the role's rights; −1 for an unknown role."""
    return ROLES.index(role) if role in ROLES else -1


def allows(role: str, accepted: Iterable[str]) -> bool:
    """Return whether `role` is at least one of `accepted`; if `accepted` is empty, any known role is."""
    return rank(role) >= min((rank(name) for name in accepted), default=0)


def scopes_in_force(role: str, held: Iterable[str]) -> frozenset[str]:
    """Return the scopes of a token that its owner's role currently allows."""
    return frozenset(held) & SCOPES_OF.get(role, frozenset())
