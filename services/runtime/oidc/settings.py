"""The settings of a provider of OpenID Connect."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from urllib.parse import SplitResult, urlsplit

from pydantic import SecretStr


@dataclass(frozen=True)
class OidcSettings:
    """Sign-in by a provider of OpenID Connect; an empty `issuer` means none. `issuer` is written as the provider's own
    `.well-known/openid-configuration` says it, to the last slash. Where we are sent back to, which the provider must
    know, is `api.url` with `/api/v1/sign-in/oidc/callback` after it.

    `client_id` and `client_secret` are what the provider gave us; without a secret we are a public client, with PKCE
    alone. `title` stands on the button: *Sign in with …*. `scopes` are asked for; `openid` is one of them.

    `groups_claim` names the claim of the ID token that lists somebody's groups. `administrators`, `curators` and
    `participants` are groups, between commas, whose members have that role, the highest where they are in several:
    roles follow at each sign-in. Where `participants` is empty, everybody whom the provider knows is one; else who is
    in no group is not let in. Where neither `administrators` nor `curators` is said, the platform alone gives roles.

    `name_claim` is what an account is called at its first sign-in. With `links_verified_email` somebody whose e-mail
    the provider says to be verified is given the account of this name that is there already, unless it is an
    administrator's or another's; otherwise an account is never somebody's by its name.

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
        """`title`, else the provider's host."""
        return self.title or urlsplit(self.issuer).hostname or ""


# Checks of the settings of a provider: contradictions with which nobody could sign in, or anybody.


LOCAL = ("localhost", "::1")
LONGEST_ISSUER = 500


def provider_contradictions(oidc: OidcSettings, is_by_password: bool) -> Iterator[str]:
    """One sentence for each. With passwords off, somebody of the provider's must administer."""
    if not is_by_password and not oidc.issuer:
        yield "STONE_API__PASSWORDS is off and STONE_OIDC__ISSUER is not set: then nobody could sign in"
    elif not is_by_password and not groups_in(oidc.administrators):
        yield (
            "STONE_API__PASSWORDS is off and STONE_OIDC__ADMINISTRATORS names no group: then nobody could administer; "
            "name one, sign in as a member, then switch passwords off"
        )
    if oidc.issuer:
        yield from _of_issuer(oidc)
    elif oidc.client_id or oidc.client_secret.get_secret_value():
        yield "STONE_OIDC__CLIENT_ID or __CLIENT_SECRET is set and STONE_OIDC__ISSUER is not: then there is no provider"


def groups_in(names: str) -> frozenset[str]:
    """Groups that a setting names, between commas."""
    return frozenset(name.strip() for name in names.split(",") if name.strip())


def is_local(parts: SplitResult) -> bool:
    """Whether an address is of this very machine."""
    host = parts.hostname or ""
    return host in LOCAL or host.startswith("127.")


def _of_issuer(oidc: OidcSettings) -> Iterator[str]:
    if not oidc.client_id:
        yield "STONE_OIDC__ISSUER needs STONE_OIDC__CLIENT_ID: what the provider calls this platform"
    if "openid" not in oidc.scopes.split():
        yield "STONE_OIDC__SCOPES must hold openid: without it the provider tells nothing of who signed in"
    if len(oidc.issuer) > LONGEST_ISSUER or not _is_sound(oidc.issuer):
        yield (
            f"STONE_OIDC__ISSUER is {oidc.issuer[:80]!r} and must be an https:// address without query, fragment or "
            "name (http:// on this machine alone): whoever is on the way could say who signs in"
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
