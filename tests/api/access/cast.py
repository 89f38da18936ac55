"""The callers of the matrix: each a way to come with, or without, a credential.

**Conventions.** `owner`, `narrow`, `expired`, `browser` and `forger` are the same user, who owns the world. What a
caller shows may depend on what is asked for: `narrow` shows a token that holds everything but the scope the route asks
for.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache

from sqlalchemy.orm import Session

from api.middleware.context import COOKIE
from services.runtime.access import passwords, sessions, tokens, users
from services.runtime.access.roles import SCOPES_OF
from services.runtime.orm import User, new_id
from services.runtime.platform import Platform

CALLERS = (
    "anonymous", "participant", "owner", "other", "administrator", "modest", "narrow", "expired", "inactive", "browser",
    "forger",
)  # fmt: skip
OF_OWNER = ("owner", "narrow", "expired", "browser", "forger")
PASSWORD = "correct horse battery staple"
LASTS_S = 400 * 86400.0

Headers = Mapping[str, str]


@dataclass(frozen=True)
class Cast:
    """What each caller shows, and which user each is (`anonymous`: nobody)."""

    headers: Mapping[str, Headers]
    narrow: Mapping[str, Headers]
    users: Mapping[str, User]

    def shown(self, caller: str, scope: str) -> Headers:
        """The headers with which `caller` asks for something that needs `scope` (empty: nothing)."""
        return self.narrow.get(scope, self.headers["owner"]) if caller == "narrow" else self.headers[caller]

    def user_id(self, caller: str) -> str:
        return self.users[caller].id if caller in self.users else ""

    @property
    def secrets(self) -> Iterator[str]:
        """Values of headers that no answer may repeat."""
        yield from (
            value.partition("=")[2] or value.partition(" ")[2]
            for one in self.headers.values()
            for value in one.values()
        )


def make_cast(platform: Platform) -> Cast:
    """Fresh users of every kind with their credentials."""
    with platform.database.transaction() as session:
        owner, other = _user(session, "curator"), _user(session, "curator")
        participant, administrator = _user(session, "participant"), _user(session, "administrator")
        inactive = _user(session, "curator")
        curators = SCOPES_OF["curator"]
        opened = sessions.open_session(session, owner, LASTS_S)
        cookie = {"Cookie": f"{COOKIE}={opened.secret}"}
        headers: dict[str, Headers] = {
            "anonymous": {}, "participant": _token(session, participant), "owner": _token(session, owner),
            "other": _token(session, other), "administrator": _token(session, administrator),
            "modest": _token(session, administrator, curators), "expired": _token(session, owner, lasts_s=-1.0),
            "inactive": _token(session, inactive), "browser": {**cookie, "X-CSRF-Token": opened.csrf_token},
            "forger": cookie,
        }  # fmt: skip
        narrow = {scope: _token(session, owner, curators - {scope}) for scope in SCOPES_OF["administrator"]}
        inactive.is_active = False
    people = dict.fromkeys(OF_OWNER, owner) | {"other": other, "participant": participant, "inactive": inactive}
    return Cast(headers, narrow, people | dict.fromkeys(("administrator", "modest"), administrator))


def _user(session: Session, role: str) -> User:
    user = users.create_user(session, f"{role}-{new_id()[-12:]}", role)
    user.password_hash = _hashed()
    return user


def _token(session: Session, user: User, scopes: frozenset[str] | None = None, lasts_s: float = LASTS_S) -> Headers:
    held = SCOPES_OF[user.role] if scopes is None else scopes
    return {"Authorization": f"Bearer {tokens.issue(session, user, 'matrix', held, lasts_s)}"}


@cache
def _hashed() -> str:
    return passwords.hash_password(PASSWORD)
