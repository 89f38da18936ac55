"""Errors that refuse a request: authentication, permission, preconditions, limits.

**Conventions.** A route raises a leaf of `StoneError`, its own or one of a service; `api/statuses.py` is the one table
that says with which status, `api/problems.py` writes the answer. A leaf's first docstring line is the problem's title,
its `code` the problem's type, its sentence the detail.
"""

from collections.abc import Mapping
from typing import Any

from stone.errors import StoneError
from stone.splits.splits import RuleFinding


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
    """Not signed in, or the token or session is no longer valid."""

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
    """The request lacks the CSRF token of the browser's session."""

    code = "csrf"

    def __init__(self) -> None:
        super().__init__("X-CSRF-Token is missing or is not this session's; read it from GET /api/v1/me")


class NotFoundError(ApiError):
    """Not found, or no access."""

    code = "not_found"

    def __init__(self, kind: str, subject_id: str) -> None:
        super().__init__(f"there is no {kind} {subject_id[:80]!r}, or you have no access to it")


class ConflictError(ApiError):
    """Not possible in the current state."""

    code = "conflict"

    def __init__(self, sentence: str) -> None:
        super().__init__(sentence)


class HiddenTruthError(ConflictError):
    """Labels that serve as hidden ground truth cannot be made public."""

    code = "hidden_truth"

    def __init__(self, name: str, where: str) -> None:
        super().__init__(
            f"sequence {name!r} is {where}: made public, anybody could fetch the labels that entries are scored "
            "against; make another sequence public, or take this one out of test before anything is published of it"
        )


class PreconditionFailedError(ApiError):
    """The resource was changed since it was read."""

    code = "precondition_failed"

    def __init__(self, given: str, current: str) -> None:
        super().__init__(f"If-Match is {given[:80]} but the resource is at {current}; read it again and retry")


class PreconditionRequiredError(ApiError):
    """A change needs the ETag of the resource (If-Match)."""

    code = "precondition_required"

    def __init__(self) -> None:
        super().__init__("If-Match is missing; send the ETag of the resource as you last read it")


class InvalidRequestError(ApiError):
    """The request does not have the form the route asks for."""

    code = "invalid_request"

    def __init__(self, findings: tuple[Mapping[str, Any], ...], total: int) -> None:
        super().__init__(f"{total} field(s) of the request are invalid; see errors")
        self._findings, self.total = findings, total

    @property
    def findings(self) -> tuple[Mapping[str, Any], ...]:
        return self._findings


class BadCursorError(ApiError):
    """The cursor does not belong to this list."""

    code = "bad_cursor"

    def __init__(self) -> None:
        super().__init__("the cursor is not one of this list; take 'next' from its last page, or begin without one")


class ReasonMissingError(ApiError):
    """An administrative action needs a reason."""

    code = "reason_missing"

    def __init__(self, act: str) -> None:
        super().__init__(f"{act} needs a reason, which is recorded in the audit log")


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
    """The program has not been approved yet."""

    code = "authorization_pending"

    def __init__(self) -> None:
        super().__init__("this program has not been approved yet; ask again after interval_s")


class DeviceSlowDownError(RateLimitedError):
    """A program asks for its token more often than it was told to."""

    code = "slow_down"

    def __init__(self, interval_s: int) -> None:
        StoneError.__init__(self, f"this program asked less than {interval_s} s ago; ask again in {interval_s} s")
        self.retry_after_s = interval_s


class DeviceDeniedError(ApiError):
    """The program was denied, or the approving account was deactivated."""

    code = "access_denied"

    def __init__(self) -> None:
        super().__init__("this program was denied; start again if that was a mistake")


class DeviceCodeError(ApiError):
    """The device code is unknown, has expired or was used."""

    code = "expired_token"

    def __init__(self) -> None:
        super().__init__("this device code is unknown, expired (ten minutes), or already used; start again")


class BadIdempotencyKeyError(ApiError):
    """Invalid Idempotency-Key."""

    code = "bad_idempotency_key"

    def __init__(self, length: int) -> None:
        super().__init__(f"an Idempotency-Key is 1 to 128 visible ASCII characters; this one has {length}")


class KeyReusedError(ApiError):
    """The same Idempotency-Key was sent with another request."""

    code = "idempotency_key_reused"

    def __init__(self) -> None:
        super().__init__("this Idempotency-Key was used with another body or query; use a new key for a new request")


class RequestInFlightError(ApiError):
    """The first request with this Idempotency-Key is still being worked on."""

    code = "request_in_flight"

    def __init__(self) -> None:
        super().__init__("the first request with this Idempotency-Key is still being worked on; ask again in a second")

    @property
    def headers(self) -> dict[str, str]:
        return {"Retry-After": "1"}


class ClientTooOldError(ApiError):
    """The client's release is no longer supported by this server."""

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


# Errors of file downloads and file uploads.


class RangeError(ApiError):
    """The range begins behind the end of the file."""

    code = "range_not_satisfiable"

    def __init__(self, size_bytes: int) -> None:
        self.size_bytes = size_bytes
        super().__init__(f"the file has {size_bytes} bytes and the range begins behind them")

    @property
    def headers(self) -> dict[str, str]:
        return {"Content-Range": f"bytes */{self.size_bytes}", "Accept-Ranges": "bytes"}


class CalibrationRefusedError(ApiError):
    """The calibration is refused; `errors` has the code of the check."""

    code = "calibration_refused"

    def __init__(self, filename: str, reason: StoneError) -> None:
        self._filename, self._reason = filename, reason
        super().__init__(str(reason))

    @property
    def findings(self) -> tuple[Mapping[str, Any], ...]:
        return ({"code": self._reason.code, "where": "file", "file": self._filename, "expected": str(self._reason)},)


# Why splits are refused: an error for each rule that is broken.


NAMED = 8


class SplitRefusedError(ApiError):
    """The splits break a rule that the data allow."""

    code = "split_refused"

    def __init__(self, errors: tuple[RuleFinding, ...], names: Mapping[str, str]) -> None:
        super().__init__(f"{len(errors)} rule(s) are broken; see errors, or have splits proposed (/splits/proposal)")
        self._errors, self._names = errors, names

    @property
    def findings(self) -> tuple[Mapping[str, Any], ...]:
        return tuple(
            {"code": error.code, "where": self._where(error), "expected": error.message} for error in self._errors
        )

    def _where(self, error: RuleFinding) -> str:
        named = [self._names.get(one, one) for one in error.sequences]
        more = f" and {len(named) - NAMED} more" if len(named) > NAMED else ""
        return ", ".join(named[:NAMED]) + more
