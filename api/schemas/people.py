"""People over the wire: the caller, sessions, tokens, users, teams; and the platform's health."""

from typing import Annotated, Literal

from pydantic import Field, SecretStr, StringConstraints

from api.schemas.base import ID_EXAMPLE, PLAIN, Answer, Body, Instant, Reason, example
from services.runtime.access.roles import Role, Scope

PASSWORD = "correct horse battery staple"
SECRET_EXAMPLE = "stone_" + "x" * 43
ENDS = "2027-05-03T09:12:44.120000Z"

UserName = Annotated[str, StringConstraints(pattern=r"^[a-z0-9._@+-]{1,64}$")]
Title = Annotated[str, StringConstraints(pattern=PLAIN, min_length=1, max_length=64, strip_whitespace=True)]
Password = Annotated[SecretStr, Field(min_length=1, max_length=1024)]


class Liveness(Answer):
    """The process lives."""

    model_config = example(status="ok")

    status: Literal["ok"]


class PartState(Answer):
    """Whether a part answered, and in how many milliseconds."""

    model_config = example(state="up", took_ms=0.8)

    state: Literal["up", "away"]
    took_ms: float


class Readiness(Answer):
    """Whether the platform can answer requests now."""

    model_config = example(
        status="ready",
        parts={name: {"state": "up", "took_ms": 0.8} for name in ("database", "broker", "store")},
    )

    status: Literal["ready", "not_ready"]
    parts: dict[str, PartState]


class SignInBody(Body):
    """A name and its password."""

    model_config = example(name="ada", password=PASSWORD)

    name: Annotated[str, StringConstraints(max_length=64)]
    password: Password


class SessionItem(Answer):
    """A browser is signed in; its cookie is in the answer's head, and unsafe requests repeat `csrf_token`."""

    model_config = example(name="ada", role="curator", csrf_token="x" * 43)

    user_id: str
    name: str
    role: str
    csrf_token: str
    expires_at: Instant


class BrowserItem(Answer):
    """A browser in which a user is signed in; `is_current` marks the calling one."""

    model_config = example(expires_at=ENDS, is_current=True)

    id: str
    created_at: Instant
    expires_at: Instant
    is_current: bool


class MeItem(Answer):
    """The caller and their permissions; `csrf_token` for browsers only."""

    model_config = example(
        name="ada", role="curator", scopes=["read", "submit", "upload"], is_session=False, expires_at=ENDS
    )

    user_id: str
    name: str
    role: str
    scopes: list[str]
    is_session: bool
    csrf_token: str | None
    expires_at: Instant


class PasswordBody(Body):
    """The caller's own password, old and new; `ends_tokens` also ends all other credentials, as after a theft."""

    model_config = example(current=PASSWORD, new="another horse, another battery")

    current: Password
    new: Password
    ends_tokens: bool = False


class TokenBody(Body):
    """A new token; by default it has all scopes of the caller except `account` and lasts a year. Tokens that it creates
    end with it.
    """

    model_config = example(name="field laptop", scopes=["read", "upload"], expires_s=2592000)

    name: Title
    scopes: Annotated[list[Scope], Field(min_length=1, max_length=5)] | None = None
    expires_s: Annotated[float, Field(ge=1, le=10 * 365 * 86400, allow_inf_nan=False)] | None = None


class TokenItem(Answer):
    """A token without its secret."""

    model_config = example(name="field laptop", scopes=["read", "upload"], expires_at=ENDS)

    id: str
    name: str
    scopes: list[str]
    created_at: Instant
    expires_at: Instant
    used_at: Instant | None


class IssuedToken(TokenItem):
    """A token with its secret, shown this once."""

    model_config = example(secret=SECRET_EXAMPLE)

    secret: str


class UserBody(Body):
    """A user to be; without a password an administrator sets one later."""

    model_config = example(name="ada", role="curator", password=PASSWORD, reason="joins the field team")

    name: UserName
    role: Role
    password: Password | None = None
    reason: Reason


class UserChange(Body):
    """Changes; missing keys stay."""

    model_config = example(role="curator", reason="leads the next campaign")

    role: Role | None = None
    is_active: bool | None = None
    password: Password | None = None
    reason: Reason


class UserItem(Answer):
    """A user."""

    model_config = example(name="ada", role="curator", is_active=True, has_password=True)

    id: str
    name: str
    role: str
    is_active: bool
    has_password: bool
    created_at: Instant


class RevokedItem(Answer):
    """Number of a user's tokens that were revoked, and of browsers that were signed out."""

    model_config = example(tokens=3, browsers=1)

    tokens: int
    browsers: int


class TeamBody(Body):
    """A team to be; its maker owns it."""

    model_config = example(name="Terrain Gang")

    name: Title


class TeamItem(Answer):
    """A team of the caller; the captain is null if all members have left.

    It takes part in `phases` (ids), and new members take part in those that have not ended.
    """

    model_config = example(name="Terrain Gang", captain="ada", members=["ada"], phases=[ID_EXAMPLE])

    id: str
    name: str
    captain: str | None
    members: list[str]
    phases: list[str]
    created_at: Instant
