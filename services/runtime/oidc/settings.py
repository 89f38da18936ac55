"""The settings of a provider of OpenID Connect."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from urllib.parse import SplitResult, urlsplit

from pydantic import SecretStr


@dataclass(frozen=True)
class OidcSettings:
    """Sign-in with an OpenID Connect provider; an empty `issuer` means no provider. Copy `issuer` exactly from the
    provider's `.well-known/openid-configuration`, including a trailing slash. Register this redirect address at the
    provider: `api.url` followed by `/api/v1/sign-in/oidc/callback`.

    `client_id` and `client_secret` come from the provider; without a secret the platform is a public client, with PKCE
    alone. `title` is the text on the button: *Sign in with …*. `scopes` are requested from the provider and must
    contain `openid`.

    `groups_claim` names the claim of the ID token with the user's groups. `administrators`, `curators` and
    `participants` are groups, separated by commas, whose members have that role; a member of several has the highest
    role. Roles are updated at each sign-in. If `participants` is empty, every user of the provider is a participant;
    otherwise users without a group cannot sign in. If neither `administrators` nor `curators` is set, only the platform
    assigns roles.

    `name_claim` names the claim with the account name at the first sign-in. With `links_verified_email` a user whose
    e-mail address is verified by the provider gets the existing account of this name, unless it is an administrator's
    or linked to another user. Otherwise accounts are never matched by name.

    A request to the provider takes `timeout_s` at most.
    """

    issuer: str = ""
    client_id: str = ""
    client_secret: SecretStr = field(default=SecretStr(""))
    title: str = ""
    scopes: str = "openid profile email"
    groups_claim: str = "groups"
    administrators: str = ""
    curators: str = ""
    participants: str = ""
    name_claim: str = "preferred_username"
    links_verified_email: bool = False
    timeout_s: float = 10.0

    @property
    def shown_title(self) -> str:
        """`title`, or else the provider's host."""
        return self.title or urlsplit(self.issuer).hostname or ""


# Checks of the settings of a provider: contradictions that would lock out all users, or admit anyone.


LOCAL = ("localhost", "::1")
LONGEST_ISSUER = 500


def provider_contradictions(oidc: OidcSettings, is_by_password: bool) -> Iterator[str]:
    """Yield one sentence per contradiction. With passwords off, the provider must have administrators."""
    if not is_by_password and not oidc.issuer:
        yield "STONE_API__PASSWORDS is off and STONE_OIDC__ISSUER is not set: no user could sign in"
    elif not is_by_password and not groups_in(oidc.administrators):
        yield (
            "STONE_API__PASSWORDS is off and STONE_OIDC__ADMINISTRATORS names no group: there would be no "
            "administrator; name a group, sign in as a member, then switch passwords off"
        )
    if oidc.issuer:
        yield from _of_issuer(oidc)
    elif oidc.client_id or oidc.client_secret.get_secret_value():
        yield "STONE_OIDC__CLIENT_ID or __CLIENT_SECRET is set, but STONE_OIDC__ISSUER is not"


def groups_in(names: str) -> frozenset[str]:
    """Return the comma-separated groups of a setting."""
    return frozenset(name.strip() for name in names.split(",") if name.strip())


def is_local(parts: SplitResult) -> bool:
    """Return whether an address is of this machine."""
    host = parts.hostname or ""
    return host in LOCAL or host.startswith("127.")


def _of_issuer(oidc: OidcSettings) -> Iterator[str]:
    if not oidc.client_id:
        yield "STONE_OIDC__ISSUER requires STONE_OIDC__CLIENT_ID, the provider's id of this platform"
    if "openid" not in oidc.scopes.split():
        yield "STONE_OIDC__SCOPES must contain openid: without it the provider sends no identity"
    if len(oidc.issuer) > LONGEST_ISSUER or not _is_sound(oidc.issuer):
        yield (
            f"STONE_OIDC__ISSUER is {oidc.issuer[:80]!r} and must be an https:// address without query, fragment or "
            "user name (http:// only on this machine): otherwise an attacker on the network could forge identities"
        )


def _is_sound(issuer: str) -> bool:
    try:
        parts = urlsplit(issuer)
        _ = parts.port
    except ValueError:
        return False
    is_plain = not (parts.query or parts.fragment or parts.username or parts.password)
    is_safe = parts.scheme == "https" or (parts.scheme == "http" and is_local(parts))
    return is_plain and is_safe and bool(parts.hostname) and issuer.isprintable() and " " not in issuer
