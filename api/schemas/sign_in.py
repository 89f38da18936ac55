"""Bodies of sign-in: the ways to sign in, and programs that wait for approval."""

from typing import Annotated, Literal

from pydantic import Field, SecretStr, StringConstraints

from api.schemas.base import PLAIN, Answer, Body, Instant, example
from api.schemas.people import Title

USER_CODE = "BCDF-GHJK"


class ProviderItem(Answer):
    """The provider to sign in with: its name, and the path that a browser opens."""

    model_config = example(title="Field Robotics Lab", path="/api/v1/sign-in/oidc")

    title: str
    path: str


class SignInWays(Answer):
    """The ways to sign in: by name and password, with a provider, or either."""

    model_config = example(passwords=True)

    passwords: bool
    provider: ProviderItem | None


class DeviceBody(Body):
    """A program that wants a token, and what it wants to do with it."""

    model_config = example(name="stone on laptop", scopes=["read", "submit"])

    name: Title
    scopes: Annotated[list[Literal["read", "upload", "submit", "admin"]], Field(min_length=1, max_length=4)]


class DeviceCodesItem(Answer):
    """The program's secret, and the code that a person types at `url`; polling for the token sooner than `interval_s`
    is refused.
    """

    model_config = example(
        device_code="x" * 43,
        user_code=USER_CODE,
        url="http://127.0.0.1:8080/device",
        url_with_code=f"http://127.0.0.1:8080/device?code={USER_CODE}",
        interval_s=5,
    )

    device_code: str
    user_code: str
    url: str
    url_with_code: str
    expires_at: Instant
    interval_s: int


class DeviceTokenBody(Body):
    """The program's secret."""

    model_config = example(device_code="x" * 43)

    device_code: Annotated[SecretStr, Field(min_length=1, max_length=64)]


class DeviceDecision(Body):
    """The code that a program showed, and whether it may have its token."""

    model_config = example(user_code=USER_CODE, approves=True)

    user_code: Annotated[str, StringConstraints(pattern=PLAIN, min_length=1, max_length=32)]
    approves: bool
