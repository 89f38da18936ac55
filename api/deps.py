"""FastAPI dependencies: the platform, and the authenticated caller.

**Conventions.** `Depends(require(scope, *roles))` returns 401 without a caller, and 403 if the caller's scopes or role
are insufficient; a higher role includes the lower ones. A browser's session has the scopes of its user's role, and its
unsafe requests must repeat the session's CSRF token. A caller is identified once per request. `Depends(look)` accepts
visitors, who see public data; for other data it returns 401.
"""

import inspect
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from hashlib import sha256
from hmac import compare_digest
from threading import Lock
from typing import Annotated, Any, Generic, TypeVar

import structlog
from cachetools import LRUCache
from fastapi import Depends, Request, Security
from fastapi.security import APIKeyCookie, HTTPAuthorizationCredentials, HTTPBearer
from sqlalchemy.exc import OperationalError
from sqlalchemy.orm import Session
from starlette.concurrency import run_in_threadpool

from api.errors import CsrfError, ForbiddenError, UnauthenticatedError
from api.middleware.context import COOKIE
from services.runtime.access import roles, sessions, tokens
from services.runtime.access.credential_changes import credentials_generation
from services.runtime.access.roles import ACCOUNT, SCOPES
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform

# Cache of callers by credential, to save a database read per request.
#
# **Conventions.** Keys are the sha256 of secrets; entries last `KEPT_S` and never beyond the credential's end. A change
# of a user, token or session takes effect at once if this process committed it, and within `KEPT_S` if another process
# did. Invalid credentials are not cached.


KEPT_S = 1.0
MOST = 10_000

C = TypeVar("C")


@dataclass(frozen=True)
class _KnownCaller(Generic[C]):
    caller: C
    generation: int
    expires_ns: int
    until_s: float


class KnownCredentials(Generic[C]):
    """Cache with `find(secret)`, and `learn(secret, …)` if that returned None."""

    def __init__(self, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s, self._lock = monotonic_s, Lock()
        self._known: LRUCache[bytes, _KnownCaller[C]] = LRUCache(MOST)

    def find(self, secret: str) -> C | None:
        """Return the caller with this credential, or None if it must be looked up."""
        with self._lock:
            known = self._known.get(_key(secret))
        if known is None or known.generation != credentials_generation():
            return None
        return known.caller if known.until_s > self._now_s() and known.expires_ns > now_ns() else None

    def learn(self, secret: str, caller: C, *, expires_ns: int, generation: int) -> None:
        """Cache a caller read from the database since `generation` was `credentials_generation()`."""
        known = _KnownCaller(caller, generation, expires_ns, self._now_s() + KEPT_S)
        with self._lock:
            self._known[_key(secret)] = known


def _key(secret: str) -> bytes:
    return sha256(secret.encode()).digest()


T = TypeVar("T")
NEEDING_CALLER = set[object]()
"""Dependencies that refuse unauthenticated requests."""
VISITING = "visitor"
SAFE = ("GET", "HEAD", "OPTIONS")
BY_COOKIE = "cookie\n"  # no Authorization header starts with this

log = structlog.get_logger(__name__)

bearer = HTTPBearer(auto_error=False, scheme_name="token", description="A token: `stone_…`, from `POST /tokens`.")
cookie = APIKeyCookie(
    name=COOKIE, auto_error=False, scheme_name="session", description="A browser's session, from `POST /sessions`."
)


@dataclass(frozen=True)
class Caller:
    """The authenticated caller with the scopes in force. `expires_ns` is the end of the token or session."""

    user_id: str
    name: str
    role: str
    scopes: frozenset[str]
    is_session: bool
    expires_ns: int = 0
    credential_id: str = ""
    csrf_token: str = ""

    @property
    def is_administrator(self) -> bool:
        return self.role == "administrator" and "admin" in self.scopes

    @property
    def is_visitor(self) -> bool:
        """Whether no user is signed in, so that only public data is shown."""
        return self.role == VISITING


VISITOR = Caller("", "", VISITING, frozenset({"read"}), is_session=False)


def platform_of(request: Request) -> Platform:
    """Return the platform of this application."""
    platform: Platform = request.app.state.platform
    return platform


async def _platform(request: Request) -> Platform:
    return platform_of(request)


PlatformDep = Annotated[Platform, Depends(_platform)]


def at_once(kind: Callable[..., T]) -> Callable[..., Awaitable[T]]:
    """Return `kind` as an async dependency; a thread would cost more than the call itself."""

    async def made(**given: Any) -> T:
        return kind(**given)

    made.__signature__ = inspect.signature(kind)  # type: ignore[attr-defined]  # what FastAPI reads the query off
    return made


def identify(request: Request) -> Caller | None:
    """Return the caller by token or session, or None without a credential. Raises `UnauthenticatedError` if it is
    invalid.
    """
    if not hasattr(request.state, "caller"):
        shown = _shown_credential(request)
        request.state.caller = None
        if shown is not None:
            request.state.caller = _known_credentials(request).find(shown) or _looked_up(request, shown)
            request.app.state.limits.know(request, request.state.caller.user_id)
    caller: Caller | None = request.state.caller
    return caller


def identify_again(request: Request) -> Caller:
    """Return the current caller of a request in progress. Raises `UnauthenticatedError`."""
    shown = _shown_credential(request)
    if shown is None:
        raise UnauthenticatedError()
    return _known_credentials(request).find(shown) or _looked_up(request, shown)


async def identify_async(request: Request) -> Caller | None:
    """Identify as `identify` does, with a thread only for callers that are not cached."""
    if hasattr(request.state, "caller"):
        return identify(request)
    shown = _shown_credential(request)
    known = None if shown is None else _known_credentials(request).find(shown)
    if shown is not None and known is None:
        return await run_in_threadpool(identify, request)
    request.state.caller = known
    if known is not None:
        request.app.state.limits.know(request, known.user_id)
    return known


def require(scope: str, *accepted: str) -> Callable[..., Awaitable[Caller]]:
    """Return a dependency that returns the caller if they have `scope` and at least one of the `accepted` roles."""
    return require_one((scope,), *accepted)


def require_one(scopes: tuple[str, ...], *accepted: str) -> Callable[..., Awaitable[Caller]]:
    """Return a dependency as `require` does, for callers with any of `scopes`; the OpenAPI document names the first."""
    scopes_and_roles = [scopes[0], *accepted]  # for the OpenAPI document only

    async def caller_who_may(
        request: Request,
        _bearer: Annotated[HTTPAuthorizationCredentials | None, Security(bearer, scopes=scopes_and_roles)],
        _cookie: Annotated[str | None, Security(cookie, scopes=scopes_and_roles)],
    ) -> Caller:
        caller = await identify_async(request)
        if caller is None:
            raise UnauthenticatedError()
        check_csrf(request, caller)
        if not caller.scopes & set(scopes):
            wanted = " or ".join(map(repr, scopes))
            raise ForbiddenError(f"this requires the scope {wanted}; your scopes are {sorted(caller.scopes)}")
        if not roles.allows(caller.role, accepted):
            raise ForbiddenError(f"this requires the role {' or '.join(accepted)}; your role is {caller.role}")
        return caller

    NEEDING_CALLER.add(caller_who_may)
    return caller_who_may


def needs_caller(dependency: object) -> bool:
    """Return whether the dependency refuses unauthenticated requests."""
    return dependency in NEEDING_CALLER


async def look(
    request: Request,
    _bearer: Annotated[HTTPAuthorizationCredentials | None, Security(bearer, scopes=["read"])],
    _cookie: Annotated[str | None, Security(cookie, scopes=["read"])],
) -> Caller:
    """Return a caller who has the scope `read`, or `VISITOR` if the request has no credential.

    A browser whose session has ended is a visitor too. An invalid token is refused, as everywhere.
    """
    try:
        caller = await identify_async(request) or VISITOR
    except UnauthenticatedError:
        if "authorization" in request.headers:
            raise
        caller = VISITOR
    request.state.caller = caller
    if "read" not in caller.scopes:
        raise ForbiddenError(f"this requires the scope 'read'; your scopes are {sorted(caller.scopes)}")
    return caller


def _shown_credential(request: Request) -> str | None:
    """Return the Authorization header, else the cookie marked by `BY_COOKIE`; None without either."""
    header, secret = request.headers.get("authorization"), request.cookies.get(COOKIE)
    if header is not None:
        return header
    return None if secret is None else f"{BY_COOKIE}{secret}"


def _known_credentials(request: Request) -> KnownCredentials[Caller]:
    known: KnownCredentials[Caller] = request.app.state.known_credentials
    return known


def _looked_up(request: Request, shown: str) -> Caller:
    platform, generation = platform_of(request), credentials_generation()
    if shown.startswith(BY_COOKIE):
        caller = _by_session(platform, shown.removeprefix(BY_COOKIE))
    else:
        caller = _by_token(platform, shown)
    _known_credentials(request).learn(shown, caller, expires_ns=caller.expires_ns, generation=generation)
    return caller


def _by_token(platform: Platform, header: str) -> Caller:
    scheme, _, secret = header.partition(" ")
    if scheme.lower() != "bearer":
        raise UnauthenticatedError("only the Bearer scheme is supported")
    with platform.database.lookups() as session:
        token = tokens.find(session, secret.strip())
    if token is None:
        raise UnauthenticatedError("the token is unknown, expired or revoked")
    if tokens.is_use_due(token):
        _note_use(platform, tokens.note_use, token.id)
    user, held = token.user, roles.scopes_in_force(token.user.role, token.scopes)
    return Caller(user.id, user.name, user.role, held, False, token.expires_ns, token.id)


def _note_use(platform: Platform, note: Callable[[Session, str], None], credential_id: str) -> None:
    """Record the use of a credential. Failures are only logged, so that users can delete files if the disk is full."""
    try:
        with platform.database.transaction() as session:
            note(session, credential_id)
    except OperationalError as error:
        log.warning(
            "could not record the last use of a credential", credential_id=credential_id, reason=str(error.orig)
        )


def _by_session(platform: Platform, secret: str) -> Caller:
    with platform.database.lookups() as session:
        row = sessions.find_session(session, secret, platform.settings.api.session_idle_s)
    if row is None:
        raise UnauthenticatedError("the session is unknown or has ended")
    if sessions.is_use_due(row):
        _note_use(platform, sessions.note_use, row.id)
    user = row.user
    held = roles.SCOPES_OF[user.role]
    return Caller(user.id, user.name, user.role, held, True, row.expires_ns, row.id, row.csrf_token)


def check_csrf(request: Request, caller: Caller) -> None:
    """Check that a browser's unsafe request has the CSRF token of its session. Raises `CsrfError`."""
    if not caller.is_session or request.method in SAFE:
        return
    offered = request.headers.get("x-csrf-token", "")
    if not compare_digest(offered.encode(), caller.csrf_token.encode()):
        raise CsrfError()


# Dependency types that name who may call a route: reader, submitter, curator, administrator.
#
# **Conventions.** Routes that create or end a credential of the caller require `AccountHolder`: a browser's session, or
# a token with the scope `account`. `Anybody` has any scope and may end the calling credential
# (`tests/api/test_callers.py`).


Looker = Annotated[Caller, Depends(look)]
Reader = Annotated[Caller, Depends(require("read"))]
Anybody = Annotated[Caller, Depends(require_one(SCOPES))]
AccountHolder = Annotated[Caller, Depends(require(ACCOUNT))]
Submitter = Annotated[Caller, Depends(require("submit"))]
Curator = Annotated[Caller, Depends(require("upload", "curator"))]
Administrator = Annotated[Caller, Depends(require("admin", "administrator"))]
