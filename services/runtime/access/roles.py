"""Roles and the scopes they allow.

**Conventions.** Roles are ordered: whatever a participant may, a curator may; whatever a curator may, an administrator.
The scope `account` is to change one's own credentials: tokens, browsers, the password. Every role allows it, and a
token has it only where it was asked for.
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
    """0 for a participant, growing with what the role may; −1 for a role we do not know."""
    return ROLES.index(role) if role in ROLES else -1


def allows(role: str, accepted: Iterable[str]) -> bool:
    """Whether `role` is at least one of `accepted`; anybody known is, where none is named."""
    return rank(role) >= min((rank(name) for name in accepted), default=0)


def scopes_in_force(role: str, held: Iterable[str]) -> frozenset[str]:
    """The scopes of a token that its owner's role allows now."""
    return frozenset(held) & SCOPES_OF.get(role, frozenset())
