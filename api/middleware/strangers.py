"""The routes that read bodies without a caller, derived from their dependencies."""

from collections.abc import Iterable, Iterator

from fastapi import APIRouter
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute

from api.deps import needs_caller


def strangers_routes(routers: Iterable[APIRouter], prefix: str) -> frozenset[tuple[str, str]]:
    """Return (method, path) of every route with a body whose dependencies all accept unauthenticated requests.

    Their paths have no parameters, so a request's path is compared with them literally.
    """
    routes = [route for router in routers for route in router.routes if isinstance(route, APIRoute)]
    open_to_all = [route for route in routes if route.body_field and not any(map(needs_caller, _calls(route)))]
    return frozenset((method, prefix + route.path) for route in open_to_all for method in route.methods or ())


def _calls(route: APIRoute) -> Iterator[object]:
    return (dependant.call for dependant in below(route.dependant))


def below(dependant: Dependant) -> Iterator[Dependant]:
    """Yield the dependant and all its dependencies."""
    yield dependant
    for dependency in dependant.dependencies:
        yield from below(dependency)
