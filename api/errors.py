"""Errors that refuse a request: authentication, permission, preconditions, limits.

**Conventions.** A route raises a leaf of `StoneError`, its own or one of a service; `api/statuses.py` is the one table
that says with which status, `api/problems.py` writes the answer. A leaf's first docstring line is the problem's title,
its `code` the problem's type, its sentence the detail.
"""

from collections.abc import Mapping
from typing import Any

from stone.errors import StoneError


class ApiError(StoneError):
    """The request is refused."""

    code = "refused"

    @property
    def headers(self) -> dict[str, str]:
        """Response headers that belong to the problem."""
        return {}

    @property
    def findings(self) -> tuple[Mapping[str, Any], ...]:
        """The single faults, where there is more than one: `{code, where, expected}`."""
        return ()


class UnauthenticatedError(ApiError):
    """Nobody is signed in, or the token or session is not valid any more."""

    code = "unauthenticated"

    def __init__(self, reason: str = "this needs a token or a session") -> None:
        super().__init__(f"{reason}; send 'Authorization: Bearer stone_…' or sign in")

    @property
    def headers(self) -> dict[str, str]:
        return {"WWW-Authenticate": 'Bearer realm="stone"'}


class WrongPasswordError(UnauthenticatedError):
    """The name or the password is wrong."""

    code = "wrong_password"

    def __init__(self) -> None:
        StoneError.__init__(self, "there is no active user with this name and this password")


class ForbiddenError(ApiError):
    """The caller is known, but their role or token does not allow this."""

    code = "forbidden"

    def __init__(self, reason: str) -> None:
        super().__init__(reason)


class CsrfError(ForbiddenError):
    """A browser's session changes something without the token that only our own pages know."""

    code = "csrf"

    def __init__(self) -> None:
        super().__init__("X-CSRF-Token is missing or is not this session's; read it from GET /api/v1/me")


class NotFoundError(ApiError):
    """There is no such thing, or it is not yours to know."""

    code = "not_found"

    def __init__(self, kind: str, subject_id: str) -> None:
        super().__init__(f"there is no {kind} {subject_id[:80]!r} that you may see")


class ConflictError(ApiError):
    """The state of the thing does not allow this now."""

    code = "conflict"

    def __init__(self, sentence: str) -> None:
        super().__init__(sentence)


class HiddenTruthError(ConflictError):
    """The labels of what is in test, or what a hidden phase is scored against, cannot be made public."""

    code = "hidden_truth"

    def __init__(self, name: str, where: str) -> None:
        super().__init__(
            f"sequence {name!r} is {where}: made public, anybody could fetch the labels that entries are scored "
            "against; make another sequence public, or take this one out of test before anything is published of it"
        )


class PreconditionFailedError(ApiError):
    """The thing has changed since it was read."""

    code = "precondition_failed"

    def __init__(self, given: str, current: str) -> None:
        super().__init__(f"If-Match is {given[:80]} but the thing is at {current}; read it again and decide anew")


class PreconditionRequiredError(ApiError):
    """A change must say which state of the thing it means."""

    code = "precondition_required"

    def __init__(self) -> None:
        super().__init__("If-Match is missing; send the ETag of the thing as you last read it")


class InvalidRequestError(ApiError):
    """The request does not have the form the route asks for."""

    code = "invalid_request"

    def __init__(self, findings: tuple[Mapping[str, Any], ...], total: int) -> None:
        super().__init__(f"{total} thing(s) in the request are not as asked; see errors")
        self._findings, self.total = findings, total

    @property
    def findings(self) -> tuple[Mapping[str, Any], ...]:
        return self._findings


class BadCursorError(ApiError):
    """The cursor is not one that this list gave."""

    code = "bad_cursor"

    def __init__(self) -> None:
        super().__init__("the cursor is not one of this list; take 'next' from its last page, or begin without one")


class ReasonMissingError(ApiError):
    """An administrator's act must say why."""

    code = "reason_missing"

    def __init__(self, act: str) -> None:
        super().__init__(f"{act} needs a reason that is not empty; it is kept in the audit log")


class BodyTooLargeError(ApiError):
    """The body is larger than the route reads."""

    code = "body_too_large"

    def __init__(self, limit_bytes: int) -> None:
        super().__init__(f"the body is larger than {limit_bytes} bytes; send files through /api/v1/uploads")


class RateLimitedError(ApiError):
    """Too many requests in too short a time."""

    code = "rate_limited"

    def __init__(self, per_minute: float, retry_after_s: int) -> None:
        super().__init__(f"more than {per_minute:g} a minute; try again in {retry_after_s} s")
        self.retry_after_s = retry_after_s

    @property
    def headers(self) -> dict[str, str]:
        return {"Retry-After": str(self.retry_after_s)}


class TooManyFailedSignInsError(RateLimitedError):
    """Too many wrong passwords, for this name or from this address: the next try waits."""

    code = "guessed_too_often"

    def __init__(self, retry_after_s: int) -> None:
        StoneError.__init__(self, f"too many wrong passwords; try again in {retry_after_s} s, or ask an administrator")
        self.retry_after_s = retry_after_s


class DevicePendingError(ApiError):
    """Nobody has approved the program yet."""

    code = "authorization_pending"

    def __init__(self) -> None:
        super().__init__("nobody has approved this program yet; ask again after interval_s")


class DeviceSlowDownError(RateLimitedError):
    """A program asks for its token more often than it was told to."""

    code = "slow_down"

    def __init__(self, interval_s: int) -> None:
        StoneError.__init__(self, f"this program asked less than {interval_s} s ago; ask again in {interval_s} s")
        self.retry_after_s = interval_s


class DeviceDeniedError(ApiError):
    """Somebody said no to the program, or was shut out since they said yes."""

    code = "access_denied"

    def __init__(self) -> None:
        super().__init__("this program was denied its token; begin again if that was a mistake")


class DeviceCodeError(ApiError):
    """The device code is unknown, has expired or was used."""

    code = "expired_token"

    def __init__(self) -> None:
        super().__init__("this device code is unknown, older than ten minutes, or its token was given out; begin again")


class BadIdempotencyKeyError(ApiError):
    """The Idempotency-Key cannot be one."""

    code = "bad_idempotency_key"

    def __init__(self, length: int) -> None:
        super().__init__(f"an Idempotency-Key is 1 to 128 visible ASCII characters; this one has {length}")


class KeyReusedError(ApiError):
    """The same Idempotency-Key was sent with another request."""

    code = "idempotency_key_reused"

    def __init__(self) -> None:
        super().__init__(
            "this Idempotency-Key stood with another body or query before; use a fresh key for a new request"
        )


class RequestInFlightError(ApiError):
    """The first request with this Idempotency-Key is still being worked on."""

    code = "request_in_flight"

    def __init__(self) -> None:
        super().__init__("the first request with this Idempotency-Key is still being worked on; ask again in a second")

    @property
    def headers(self) -> dict[str, str]:
        return {"Retry-After": "1"}


class ClientTooOldError(ApiError):
    """The client is of a release that this server does not understand any more."""

    code = "client_too_old"

    def __init__(self, release: str, oldest: str, install: str) -> None:
        super().__init__(
            f"this client is of release {release}, this server understands {oldest} and newer; update the client: "
            f"{install}"
        )
        self._oldest = oldest

    @property
    def headers(self) -> dict[str, str]:
        return {"Upgrade": f"stone-client/{self._oldest}"}  # which RFC 9110 asks of a 426


class ReplyNotKeptError(ApiError):
    """The first request with this Idempotency-Key took effect, but its answer was not kept."""

    code = "reply_not_kept"

    def __init__(self) -> None:
        sentence = "the first request with this Idempotency-Key took effect, but its answer held a secret or was lost"
        super().__init__(f"{sentence}; look for what it made in the list")
