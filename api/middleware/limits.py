"""Rate limits: token buckets per caller or address, for requests and sign-in attempts.

**Conventions.** A bucket holds the requests of one minute and fills evenly. Callers with a valid credential have their
own bucket. All others share the bucket of their address (for IPv6 of the /64), so inventing tokens does not help.
Buckets are in memory, per process; the `MOST_BUCKETS` last used are kept. All requests count except `PROBES`. Static
files (`FILES`) count separately, because a page loads dozens at once and then caches them.
"""

import ipaddress
import math
import time
from collections.abc import Callable
from hashlib import sha256
from threading import Lock

from cachetools import LRUCache
from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from api.errors import rate_limited
from api.middleware.context import COOKIE
from services.runtime.access.login_throttle import SignInTry
from services.runtime.settings import Settings

UPLOADS = "/api/v1/uploads"
MOST_BUCKETS = 10_000
PROBES = ("/healthz", "/readyz")
FILES = "/assets/"
FILES_SHARE = 10  # ratio of the rate of static files to the rate of other requests
NAME_SHARE = 3  # ratio of sign-ins with one name from everywhere to those from one address


class Buckets:
    """`take(key, per_minute)` takes one token, or returns the seconds until there is one."""

    def __init__(self, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s, self._lock = monotonic_s, Lock()
        self._held: LRUCache[str, tuple[float, float]] = LRUCache(MOST_BUCKETS)

    def take(self, key: str, per_minute: float) -> float:
        """Return 0.0 if a token was taken, else the seconds until there is one."""
        with self._lock:
            now_s = self._now_s()
            tokens, since_s = self._held.get(key, (per_minute, now_s))
            tokens = min(per_minute, tokens + (now_s - since_s) * per_minute / 60.0)
            self._held[key] = (tokens - 1.0 if tokens >= 1.0 else tokens, now_s)
        return 0.0 if tokens >= 1.0 else (1.0 - tokens) * 60.0 / per_minute


class RequestLimits:
    """The rate limits of one application."""

    def __init__(self, settings: Settings, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._api = settings.api
        self._buckets = Buckets(monotonic_s)
        self._known: LRUCache[str, str] = LRUCache(MOST_BUCKETS)
        self._lock = Lock()

    def admit(self, request: Request) -> None:
        """Count a request, except a piece of a known caller's upload. Raises `rate_limited`."""
        with self._lock:
            known = self._known.get(credential_of(request))
        who, per_minute = known or address_of(request), self._api.requests_per_minute
        if request.url.path.startswith(FILES):
            self._take(f"files to {who}", per_minute * FILES_SHARE)
        elif not (known and is_piece(request)):
            self._take(who, per_minute)

    def admit_sign_in(self, request: Request, tried: SignInTry) -> None:
        """Count a password attempt, by address and by name. Raises `rate_limited`.

        If the address is known for the name, the attempt counts for the pair only, apart from all others.
        """
        if tried.is_known:
            self._take(f"sign-in {address_of(request)} as {tried.name}", self._api.sign_ins_per_minute)
            return
        self._take(f"sign-in {address_of(request)}", self._api.sign_ins_per_minute)
        self._take(f"sign-in as {tried.name}", self._api.sign_ins_per_minute * NAME_SHARE)

    def admit_from(self, request: Request, what: str) -> None:
        """Count an unauthenticated `what` by address, at the rate of sign-ins with one name. Raises `rate_limited`."""
        self._take(f"{what} {address_of(request)}", self._api.sign_ins_per_minute * NAME_SHARE)

    def admit_guess(self, user_id: str) -> None:
        """Count a typed code, right or wrong. Raises `rate_limited`."""
        self._take(f"code by {user_id}", self._api.sign_ins_per_minute * NAME_SHARE)

    def know(self, request: Request, user_id: str) -> None:
        """Count later requests with this credential for this user."""
        with self._lock:
            self._known[credential_of(request)] = f"user {user_id}"

    def _take(self, key: str, per_minute: float) -> None:
        wait_s = self._buckets.take(key, per_minute)
        if wait_s:
            raise rate_limited(per_minute, math.ceil(wait_s))


class RateLimit:
    """An ASGI application that counts requests before another."""

    def __init__(self, app: ASGIApp, limits: RequestLimits) -> None:
        self._app, self._limits = app, limits

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and scope["path"] not in PROBES:
            self._limits.admit(Request(scope))
        await self._app(scope, receive, send)


def is_piece(request: Request) -> bool:
    """Return whether the request brings bytes of an upload, which quota and length limit instead of the rate."""
    return request.method == "PATCH" and request.url.path.startswith(UPLOADS)


def credential_of(request: Request) -> str:
    """Return a hash of the request's credential, so that memory does not hold the secret."""
    shown = request.headers.get("authorization") or request.cookies.get(COOKIE, "")
    return sha256(shown.encode()).hexdigest()


def address_of(request: Request) -> str:
    """Return the address of the request's client, as limits count it."""
    return f"address {site_of(request.client.host if request.client else '')}"


def site_of(host: str) -> str:
    """Return an IPv4 address, the /64 of an IPv6 address (one site has it), or any other host unchanged."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host
    mapped = getattr(address, "ipv4_mapped", None)
    if address.version == 4 or mapped is not None:
        return str(mapped or address)
    return str(ipaddress.ip_network((address, 64), strict=False))
