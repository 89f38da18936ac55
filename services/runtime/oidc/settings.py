"""The settings of a provider of OpenID Connect."""

from dataclasses import dataclass, field
from urllib.parse import urlsplit

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
