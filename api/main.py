"""The FastAPI application: its middleware and routes.

**Conventions.** A request passes, from outside in: `renamed_paths`, `https` (if the public URL is HTTPS), `entry` (id,
log, metrics, headers, faults), `limits` (rate), `releases` (client version), `bodies` (sender, size, time),
`idempotency`, router. Routes live under `/api/v1`, a module per noun; probes at the root.
"""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import cache
from typing import Any

from anyio import to_thread
from fastapi import APIRouter, Depends, FastAPI
from fastapi.telemetry import TelemetryConfig
from starlette.routing import BaseRoute, Match
from starlette.types import Scope

from api import problems
from api.client_wheel import client_wheel, install_line
from api.deps import Caller, KnownCredentials
from api.metrics import RequestMetrics
from api.middleware.bodies import BodyLimit
from api.middleware.connections import Connections
from api.middleware.entry import Releases, RequestMiddleware
from api.middleware.https import Https
from api.middleware.idempotency import Idempotency
from api.middleware.limits import RateLimit, RequestLimits
from api.middleware.renamed_paths import RenamedPaths
from api.middleware.strangers import strangers_routes
from api.openapi import PREFIX, documented, operation_id
from api.probes import Probes
from api.query import known_query
from api.routes import (
    audit,
    benchmarks,
    client,
    dataset_imports,
    dataset_inputs,
    datasets,
    docs,
    events,
    frame_pictures,
    health,
    jobs,
    leaderboard,
    notifications,
    phase_inputs,
    results,
    sessions,
    splits,
    statistics,
    submissions,
    teams,
    tokens,
    uploads,
    users,
)
from api.routes import problems as problem_routes
from api.routes.admin import admin_alarms, admin_benchmarks, admin_jobs, admin_rescores, admin_truths
from api.routes.sequences import (
    calibrations,
    exports,
    frame_views,
    frames,
    label_sets,
    processing,
    profiles,
    recordings,
    scenes,
    sequences,
)
from api.routes.sign_in_ways import device_grants, provider
from services.runtime.database.ballast import Ballast
from services.runtime.database.transactions import request_threads
from services.runtime.oidc.provider import Provider
from services.runtime.platform import Platform, open_platform
from services.runtime.sandbox.fork_client import use_fork_server
from services.runtime.settings import Settings
from services.runtime.telemetry.log_lines import speak_json
from services.runtime.telemetry.tracing import setup_tracing
from stone_base.process_tuning import tune_api

ROUTERS: tuple[APIRouter, ...] = (
    docs.router,
    problem_routes.router,
    client.router,
    sessions.router,
    provider.router,
    device_grants.router,
    tokens.router,
    users.router,
    teams.router,
    notifications.router,
    audit.router,
    uploads.router,
    sequences.router,
    calibrations.router,
    recordings.router,
    recordings.roots_router,
    profiles.router,
    processing.router,
    frames.router,
    frame_views.router,
    scenes.router,
    splits.router,
    statistics.router,
    datasets.router,
    dataset_imports.router,
    dataset_inputs.router,
    benchmarks.router,
    leaderboard.router,
    results.router,
    frame_pictures.router,
    admin_benchmarks.router,
    admin_truths.router,
    exports.router,
    label_sets.router,
    phase_inputs.router,
    submissions.router,
    jobs.router,
    admin_jobs.router,
    admin_rescores.router,
    admin_alarms.router,
    events.router,
)


def make_api(platform: Platform, shown: problems.Shown = problems.as_it_is) -> FastAPI:
    """Return the application on this platform; `shown` renders its refusals and faults."""
    api = FastAPI(
        routes=list(_routes()),
        title="STONE API",
        version="1",
        description=DESCRIPTION,
        openapi_url=f"{PREFIX}/openapi.json",
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,  # a redirect would use the Host header
        generate_unique_id_function=operation_id,
        telemetry=UNTOLD,
        lifespan=with_request_threads,
    )
    api.openapi = documented(api)  # type: ignore[method-assign]  # as FastAPI's own pages say to
    api.state.platform, api.state.limits = platform, RequestLimits(platform.settings)
    if platform.database.is_sqlite:
        platform.database.ballast = Ballast(platform.settings)
    api.state.connections = Connections(platform.settings.api)
    api.state.provider = Provider(platform.settings.oidc, platform.settings.api.url)
    api.state.meters, api.state.probes = RequestMetrics(platform), Probes(platform)
    api.state.client_wheel, api.state.known_credentials = client_wheel(), KnownCredentials[Caller]()
    problems.install(api, shown)
    # The last middleware added is the outermost.
    api.add_middleware(Idempotency)
    api.add_middleware(BodyLimit, settings=platform.settings, strangers=strangers_routes(ROUTERS, PREFIX))
    api.add_middleware(Releases, install=install_line(platform.settings.api.url, api.state.client_wheel))
    api.add_middleware(RateLimit, limits=api.state.limits)
    trusts = platform.settings.api.trusts_traceparent
    api.add_middleware(RequestMiddleware, meters=api.state.meters, shown=shown, trusts_traceparent=trusts)
    if platform.settings.api.url.startswith("https://"):
        api.add_middleware(Https)
    api.add_middleware(RenamedPaths)
    return api


@cache
def _routes() -> tuple[BaseRoute, ...]:
    """Return the routes, shared by all applications of a process; each is initialised at its first request."""
    whole = APIRouter(redirect_slashes=False, generate_unique_id_function=operation_id)
    include(whole, health.router)
    for router in ROUTERS:
        include(whole, router, prefix=PREFIX, dependencies=[Depends(known_query(router))])
    return tuple(whole.routes)


def include(whole: APIRouter | FastAPI, router: APIRouter, prefix: str = "", **options: Any) -> None:
    """Include the router so that requests skip it unless their path starts like one of its paths before a parameter.

    FastAPI compares a request with every route before its own. Without this a list of jobs takes 26 % more CPU time, a
    page 16 %, a style sheet 87 %.
    """
    starts = tuple({prefix + getattr(route, "path", "").partition("{")[0] for route in router.routes})

    def matches(scope: Scope) -> tuple[Match, Scope]:
        if scope["path"].startswith(starts, len(scope.get("root_path", ""))):
            return APIRouter.matches(router, scope)
        return Match.NONE, {}

    router.matches = matches  # type: ignore[method-assign]
    whole.include_router(router, prefix=prefix, **options)


@asynccontextmanager
async def with_request_threads(api: FastAPI) -> AsyncIterator[None]:
    """Give requests as many threads as there are database connections, while the application runs."""
    threads = request_threads(api.state.platform.settings.database.pool_size)
    to_thread.current_default_thread_limiter().total_tokens = threads
    yield


FORKED_FROM = ("api.sandboxed_reading",)


def from_environment() -> FastAPI:
    """Return the application of this process.

    `uvicorn --factory api.main:from_environment --http api.middleware.heads:BoundedHeads --no-server-header`
    """
    speak_json()
    return configure_process(make_api(open_platform(Settings())))


def configure_process(api: FastAPI) -> FastAPI:
    """Set up tracing, metrics, the fork server and GC for a stand-alone API process; return the application."""
    use_fork_server(FORKED_FROM).ensure_running()
    setup_tracing("stone-api")
    api.state.meters.keep_writing()
    tune_api()
    return api


UNTOLD: TelemetryConfig = {"tracing": False, "metrics": False, "logs": False, "auto_configure": False}
"""Options that disable FastAPI's own spans, which contain paths, queries and body errors; `entry` makes ours."""

DESCRIPTION = """STONE turns recordings of field robots into 3D traversability labels.

Refusals are `application/problem+json`. Lists are paged by `cursor`. Creating POSTs accept an `Idempotency-Key`.
Resources that can change have an `ETag`, and changing them requires `If-Match`. Boards and the lists of sequences,
jobs, submissions, exports and versions have an `ETag` too: with `If-None-Match`, an unchanged list is not sent again.
"""
