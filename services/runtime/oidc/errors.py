"""Refusals of a sign-in by a provider."""

from stone.errors import PlatformFaultError


def provider_unavailable(host: str, reason: str) -> PlatformFaultError:
    return PlatformFaultError(
        "provider_unavailable", f"the sign-in provider {host} is unavailable: {reason[:200]}; try again in a minute"
    )


def provider_answer(what: str, reason: str) -> PlatformFaultError:
    return PlatformFaultError("provider_answer", f"the provider's {what} {reason[:300]}; check STONE_OIDC__ISSUER")
