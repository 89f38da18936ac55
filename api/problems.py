"""Error responses as `application/problem+json` (RFC 9457).

**Conventions.** `type` is `/api/v1/problems/<code>`, which describes it; `detail` is one sentence; `errors` are the
first hundred findings of `errors_total`. A problem repeats only names and lengths of the request, and no internals.
"""

import errno
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from typing import Any

import structlog
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from pydantic import BaseModel, Field
from sqlalchemy.exc import DataError, IntegrityError, InterfaceError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError
from starlette.exceptions import HTTPException

from api.errors import ApiError, ForbiddenError, NotFoundError, RefusedBodyError, UnauthenticatedError, no_json
from api.field_findings import MOST_WORDS, field_finding
from api.middleware.context import request_id
from api.middleware.methods import allowed
from api.schemas.base import instant
from api.statuses import PROBLEM_TYPES, ProblemType, phrase_of
from services.domain.benchmarks.submissions.errors import ExhaustedError
from services.runtime.database.ballast import is_full
from services.runtime.orm.base import now_ns
from services.runtime.store.faults import ObjectDamagedError, note_served
from services.runtime.store.own_names import without_paths
from stone.errors import StoneError

MEDIA_TYPE = "application/problem+json"
MOST_FINDINGS = 100
PROBLEMS_PATH = "/api/v1/problems"
BUSY_S = "2"
GRANTED_WITHIN_S = 86_400

Shown = Callable[[Request, Response], Response]
"""A function that renders a refusal or fault for this request."""

log = structlog.get_logger(__name__)


class ProblemFinding(BaseModel):
    """One finding about the request."""

    code: str
    where: str = ""
    file: str | None = None
    frame: str | None = None
    expected: str | None = None
    actual: str | None = None
    detail: str | None = None


class Problem(BaseModel):
    """A refusal or fault as a response body."""

    type: str = Field(examples=["/api/v1/problems/not_found"])
    title: str
    status: int = Field(examples=[404])
    detail: str
    code: str = Field(examples=["not_found"])
    request_id: str
    errors: list[ProblemFinding] = []
    errors_total: int = 0
    next_slot_at: datetime | None = Field(
        default=None, description="Time at which the request can succeed; null if unknown."
    )


def problem(code: str, detail: str, status: int = 500) -> Problem:
    """Return a problem of this request by its code; `status` is used for codes that the table lacks."""
    kind = PROBLEM_TYPES.get(code) or ProblemType(status, phrase_of(status))
    where, (known, title) = f"{PROBLEMS_PATH}/{code}", kind
    return Problem(type=where, title=title, status=known, detail=detail, code=code, request_id=request_id())


def answer(body: Problem, headers: Mapping[str, str] | None = None) -> JSONResponse:
    """Return the problem as a response that must not be cached."""
    content = body.model_dump(mode="json", exclude_none=True)
    kept = {"Cache-Control": "no-store", **({"Retry-After": BUSY_S} if body.status == 503 else {}), **(headers or {})}
    return JSONResponse(content, body.status, headers=kept, media_type=MEDIA_TYPE)


def answer_to(error: StoneError) -> JSONResponse:
    """Return the response to a refusal, by the table."""
    if error.code not in PROBLEM_TYPES:
        log.error("refusal code without a problem type", code=error.code, sentence=str(error))
        return internal_error()
    body = problem(error.code, without_paths(str(error)))
    if isinstance(error, ExhaustedError):
        return _exhausted(body, error)
    if not isinstance(error, ApiError):
        return answer(body)
    body.errors = [ProblemFinding.model_validate(finding) for finding in error.findings[:MOST_FINDINGS]]
    body.errors_total = error.total
    return answer(body, error.headers)


def _exhausted(body: Problem, error: ExhaustedError) -> JSONResponse:
    """Add the time of the next slot; without one, let clients retry the next day instead of at once."""
    wait_s = GRANTED_WITHIN_S
    if error.next_ns is not None:
        body.next_slot_at = instant(error.next_ns)
        wait_s = max(1, -(-(error.next_ns - now_ns()) // 10**9))
    return answer(body, {"Retry-After": str(wait_s)})


def internal_error() -> JSONResponse:
    """Return a 500 response that contains only the request's id."""
    return answer(problem("internal_error", "internal error; report it with its request_id"))


def as_it_is(_request: Request, answer: Response) -> Response:
    """Return the problem unchanged; pages render it in their own words."""
    return answer


def install(app: FastAPI, shown: Shown = as_it_is) -> None:
    """Turn exceptions of routes into problems; `middleware/entry.py` passes other exceptions to `respond`."""

    def answered(request: Request, error: Exception) -> Response:
        if isinstance(error, ObjectDamagedError):
            note_served(request.app.state.platform.database, error.object_keys)
        response = respond(_hide_from_visitor(request, error))
        if response.status_code == 405:
            response.headers["Allow"] = allowed(request) or response.headers.get("Allow", "")
        return shown(request, response)

    for kind, _ in ANSWERS:
        app.add_exception_handler(kind, answered)


def _hide_from_visitor(request: Request, error: Exception) -> Exception:
    """Return the error for this caller: visitors get 401 instead of 403 or 404."""
    is_visiting = getattr(getattr(request.state, "caller", None), "is_visitor", False)
    return UnauthenticatedError() if is_visiting and isinstance(error, NotFoundError | ForbiddenError) else error


def respond(error: Exception) -> JSONResponse:
    """Return the response to any exception; an unhandled one is logged with its traceback and is a 500."""
    for kind, shape in ANSWERS:
        if isinstance(error, kind):
            return shape(error)
    log.error("unhandled exception", exc_info=error)
    return internal_error()


def _invalid(error: Any) -> JSONResponse:
    if isinstance(error.body, bytes) and error.body:  # without a JSON Content-Type, FastAPI passes the body on as bytes
        return answer_to(no_json())
    raw: Sequence[Any] = error.errors()
    findings = tuple(field_finding(error_record) for error_record in raw[:MOST_FINDINGS])
    return answer_to(invalid_request(findings, len(raw)))


def _http(error: Any) -> JSONResponse:
    if isinstance(error, RefusedBodyError):
        return answer_to(error.refusal)
    return answer(_of_http(error.status_code, str(error.detail)[:MOST_WORDS]), error.headers)


def _of_http(status: int, detail: str) -> Problem:
    match status:
        case 400:
            return problem("bad_request", detail)
        case 404:
            return problem("not_found", "no such route; see /api/v1/openapi.json")
        case 405:
            return problem("method_not_allowed", "the route does not support this method; see the Allow header")
    return problem(phrase_of(status).lower().replace(" ", "_").replace("-", "_"), detail, status)


def _system(error: Any) -> JSONResponse:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return _disk_full()
    log.error("operating system error", exc_info=error)
    return internal_error()


def _disk_full() -> JSONResponse:
    sentence = "the platform's disk is full; nothing was lost, try again later"
    return answer(problem("insufficient_storage", sentence))


def _unstorable(error: Any) -> JSONResponse:
    log.warning("the database rejected a value", exc_info=error)
    return answer(problem("unstorable_value", "a value has an unsupported character or size"))


def _raced(error: Any) -> JSONResponse:
    log.warning("constraint violated", exc_info=error)
    return answer(problem("conflict", "another request changed the resource at the same time; read it again and retry"))


def _database_away(error: Any) -> JSONResponse:
    log.error("database unreachable", reason=str(error)[:300])
    if isinstance(error, OperationalError) and is_full(error):
        return _disk_full()
    if "no such column" in str(error) or "no such table" in str(
        error
    ):  # SQLite's messages; PostgreSQL has a class for them
        return internal_error()
    sentence = "the database is unreachable or too busy; nothing was changed, try again"
    return answer(problem("database_unavailable", sentence))


ANSWERS: tuple[tuple[type[Exception], Callable[[Any], JSONResponse]], ...] = (
    (StoneError, answer_to),
    (RequestValidationError, _invalid),
    (HTTPException, _http),
    (OSError, _system),
    (DataError, _unstorable),
    (IntegrityError, _raced),
    (OperationalError, _database_away),
    (InterfaceError, _database_away),
    (PoolTimeoutError, _database_away),
)


def invalid_request(findings: tuple[Mapping[str, Any], ...], total: int) -> ApiError:
    first = f"{findings[0]['where']}: {findings[0]['detail']}" if findings else "see errors"
    more = f"; {total - 1} more in errors" if total > 1 else ""
    return ApiError("invalid_request", f"the request is invalid: {first}{more}", None, findings, total)
