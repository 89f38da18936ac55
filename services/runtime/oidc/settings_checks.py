"""Checks of the settings of a provider: contradictions with which nobody could sign in, or anybody."""

from collections.abc import Iterator
from urllib.parse import SplitResult, urlsplit

from services.runtime.oidc.settings import OidcSettings

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
