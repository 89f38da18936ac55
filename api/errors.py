"""Errors that refuse a request: authentication, permission, preconditions, limits.

**Conventions.** A route raises `ApiError`, and a service its own refusal. `api/statuses.py` maps codes to statuses and
titles; `api/problems.py` writes the response.
"""

from collections.abc import Mapping
from typing import Any

from starlette.exceptions import HTTPException

from stone.errors import Refused, StoneError
from stone.splits.splits import RuleFinding

BEARER = {"WWW-Authenticate": 'Bearer realm="stone"'}


class ApiError(Refused):
    """A refused request; `headers` are added to the response, `findings` are `ProblemFinding`s."""

    def __init__(
        self,
        code: str,
        sentence: str,
        headers: Mapping[str, str] | None = None,
        findings: tuple[Mapping[str, Any], ...] = (),
        total: int | None = None,
    ) -> None:
        super().__init__(code, sentence)
        self.headers, self.findings = dict(headers or {}), findings
        self.total = len(findings) if total is None else total


class UnauthenticatedError(ApiError):
    """Not signed in, or the token or session is no longer valid."""

    def __init__(self, reason: str = "this requires a token or a session") -> None:
        super().__init__("unauthenticated", f"{reason}; send 'Authorization: Bearer stone_…' or sign in", BEARER)


def wrong_password() -> ApiError:
    return ApiError("wrong_password", "wrong name or password", BEARER)


class ForbiddenError(ApiError):
    """The caller's role or token scopes do not allow this."""

    def __init__(self, reason: str) -> None:
        super().__init__("forbidden", reason)


class CsrfError(ForbiddenError):
    """The request lacks the CSRF token of the browser's session."""

    def __init__(self) -> None:
        ApiError.__init__(self, "csrf", "X-CSRF-Token is missing or not of this session; read it from GET /api/v1/me")


class NotFoundError(ApiError):
    """Not found, or no access."""

    def __init__(self, kind: str, subject_id: str) -> None:
        super().__init__("not_found", f"there is no {kind} {subject_id[:80]!r}, or you have no access to it")


def bad_cursor() -> ApiError:
    return ApiError(
        "bad_cursor", "the cursor does not belong to this list; use 'next' of the last page, or start without a cursor"
    )


def body_too_large(limit_bytes: int) -> ApiError:
    return ApiError(
        "body_too_large", f"the body is larger than {limit_bytes} bytes; send files through /api/v1/uploads"
    )


def body_too_slow(came_bytes: int, within_s: float) -> ApiError:
    sentence = f"only {came_bytes} bytes of the body arrived in {within_s:.0f} s; send the request again"
    return ApiError("body_too_slow", sentence, {"Connection": "close"})


class RefusedBodyError(HTTPException):
    """A refusal while a body is read, as the only error type that FastAPI passes on there."""

    def __init__(self, refusal: ApiError) -> None:
        super().__init__(400)
        self.refusal = refusal


def no_json() -> ApiError:
    return ApiError(
        "unsupported_media_type",
        "the Content-Type is not JSON; send 'Content-Type: application/json'",
    )


def rate_limited(per_minute: float, retry_after_s: int) -> ApiError:
    return ApiError(
        "rate_limited",
        f"more than {per_minute:g} requests a minute; try again in {retry_after_s} s",
        {"Retry-After": str(retry_after_s)},
    )


class CalibrationRefusedError(ApiError):
    """Invalid calibration; `errors` has the code of the check."""

    def __init__(self, filename: str, reason: StoneError) -> None:
        finding = {"code": reason.code, "where": "file", "file": filename, "detail": str(reason)}
        super().__init__("calibration_refused", str(reason), findings=(finding,))


NAMED = 8


def split_refused(errors: tuple[RuleFinding, ...], names: Mapping[str, str]) -> ApiError:
    sentence = f"the splits break {len(errors)} rule(s); see errors, or request a proposal (/splits/proposal)"
    findings = tuple({"code": error.code, "where": _where(error, names), "detail": error.message} for error in errors)
    return ApiError("split_refused", sentence, findings=findings)


def _where(error: RuleFinding, names: Mapping[str, str]) -> str:
    named = [names.get(sequence_id, sequence_id) for sequence_id in error.sequences]
    more = f" and {len(named) - NAMED} more" if len(named) > NAMED else ""
    return ", ".join(named[:NAMED]) + more
