"""Refuse unknown query parameters, like unknown keys of a body.

**Conventions.** If a route ignored unknown parameters, a list with a misspelt filter would be unfiltered. The responses
of OpenID Connect providers are exempt: a client must ignore unknown parameters (RFC 6749, section 4.1.2).
"""

from collections.abc import Awaitable, Callable

from fastapi import APIRouter, Request
from fastapi.routing import APIRoute

from api.deps import identify_async
from api.field_findings import MOST_NAME
from api.middleware.strangers import below
from api.problems import MOST_FINDINGS, invalid_request

EXEMPT = "/sign-in/oidc/callback"


def known_query(router: APIRouter) -> Callable[[Request], Awaitable[None]]:
    """Return a dependency that refuses parameters which the router's routes do not name."""
    routes = [route for route in router.routes if isinstance(route, APIRoute) and route.path != EXEMPT]
    known = {route.endpoint: _names(route) for route in routes}

    async def refuse_unknown(request: Request) -> None:
        names = known.get(request.scope["endpoint"])
        if names is None or not request.scope["query_string"]:
            return
        if unknown := [name for name in request.query_params if name not in names]:
            expected = f"one of {', '.join(names)}" if names else "no query parameters"
            await identify_async(request)  # an invalid credential is refused first, and the log names the caller
            findings = tuple(_finding(name, expected) for name in unknown[:MOST_FINDINGS])
            raise invalid_request(findings, len(unknown))

    return refuse_unknown


def _names(route: APIRoute) -> tuple[str, ...]:
    return tuple(sorted({field.alias for dependant in below(route.dependant) for field in dependant.query_params}))


def _finding(name: str, expected: str) -> dict[str, str]:
    detail = f"unknown query parameter; expected {expected}"
    return {"code": "unknown_parameter", "where": f"query.{name[:MOST_NAME]}", "expected": expected, "detail": detail}
