"""Refusals of a sign-in by a provider."""

from stone.errors import PlatformFaultError, StoneError


class NoProviderError(StoneError):
    """No provider of OpenID Connect is set up here."""

    code = "no_provider"

    def __init__(self) -> None:
        super().__init__("this platform has no provider to sign in with; an administrator sets STONE_OIDC__ISSUER")


class SignInStateError(StoneError):
    """The answer of a provider does not belong to a sign-in that this browser began."""

    code = "sign_in_state"

    def __init__(self, reason: str) -> None:
        super().__init__(f"{reason}; begin again at the sign-in page, in one window, within ten minutes")


class ProviderRefusedError(StoneError):
    """The provider denied the sign-in."""

    code = "provider_refused"

    def __init__(self, error: str) -> None:
        super().__init__(f"the provider answered {error[:80]!r}; sign in there as somebody who may use this platform")


class ProviderAwayError(PlatformFaultError):
    """The provider does not answer, or not in time."""

    def __init__(self, host: str, reason: str) -> None:
        super().__init__("provider_away", f"{host} cannot be asked who signs in: {reason[:200]}; try again in a minute")


class ProviderAnswerError(PlatformFaultError):
    """What the provider answered is not what the standard says."""

    def __init__(self, what: str, reason: str) -> None:
        super().__init__(
            "provider_answer", f"the provider's {what} {reason[:300]}; is STONE_OIDC__ISSUER the right one?"
        )


class IdTokenRefusedError(StoneError):
    """The ID token is not one that the provider made for this sign-in."""

    code = "id_token_refused"

    def __init__(self, reason: str) -> None:
        super().__init__(f"the ID token {reason[:300]}; nobody was signed in")


class NotAdmittedError(StoneError):
    """None of the user's groups is admitted."""

    code = "not_admitted"

    def __init__(self, claim: str) -> None:
        super().__init__(
            f"none of your groups (the claim {claim!r}) is admitted here; ask an administrator which one is"
        )


class ShutOutError(StoneError):
    """The account is deactivated."""

    code = "shut_out"

    def __init__(self, name: str) -> None:
        super().__init__(f"the account {name!r} is deactivated; ask an administrator of the platform")
