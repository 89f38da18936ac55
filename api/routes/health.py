"""Health routes: liveness, readiness and metrics.

**Conventions.** `/healthz` checks no component, so that an unreachable database does not restart the API. `/readyz`
probes all three components at once, each for at most `PATIENCE_S`. `/metrics` requires the monitoring token of the
settings or an administrator.
"""

from hmac import compare_digest
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Request, Response, Security
from fastapi.security import HTTPAuthorizationCredentials

from api.answers import refusal, refusals
from api.deps import bearer, identify, platform_of
from api.errors import ForbiddenError, UnauthenticatedError
from api.probes import Probes
from api.schemas.people import Liveness, Readiness

router = APIRouter(tags=["probes"])

EXPOSITION = "text/plain; version=0.0.4; charset=utf-8"

WATCHERS = ["admin", "administrator"]


@router.get("/healthz", summary="Show whether the process is alive")
def show_liveness() -> Liveness:
    return Liveness(status="ok")


@router.get(
    "/readyz",
    summary="Show whether database, broker and store are available",
    response_model=Readiness,
    responses={503: {"model": Readiness, "description": "At least one is unavailable"}},
)
def show_readiness(request: Request, response: Response) -> Readiness:
    probes: Probes = request.app.state.probes
    parts = probes.ask()
    is_ready = all(part.state == "up" for part in parts.values())
    response.status_code = 200 if is_ready else 503
    return Readiness(status="ready" if is_ready else "not_ready", parts=parts)


def may_read_metrics(
    request: Request, _bearer: Annotated[HTTPAuthorizationCredentials | None, Security(bearer, scopes=WATCHERS)]
) -> None:
    """Accept the monitoring token and administrators. Raises `UnauthenticatedError` or `ForbiddenError` for others."""
    expected = platform_of(request).settings.api.metrics_token.get_secret_value().split()
    offered = request.headers.get("authorization", "").partition(" ")[2]
    if any([compare_digest(offered.encode(), credential.encode()) for credential in expected]):
        return
    caller = identify(request)
    if caller is None:
        raise UnauthenticatedError()
    if not caller.is_administrator:
        raise ForbiddenError("metrics are for administrators and for the monitoring token")


@router.get(
    "/metrics",
    summary="Show the metrics for Prometheus",
    response_class=Response,
    responses={200: {"content": {EXPOSITION: {"schema": {"type": "string"}}}}, 401: refusal(401), **refusals(403)},
)
def show_metrics(request: Request, _allowed: Annotated[None, Depends(may_read_metrics)]) -> Response:
    meters: Any = request.app.state.meters
    return Response(meters.exposition(), media_type=EXPOSITION)
