"""The routes that read a body of whom they do not know: found by their dependencies, named nowhere."""

from collections.abc import Iterable, Iterator

from fastapi import APIRouter
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute

from api.deps import needs_caller


def strangers_routes(routers: Iterable[APIRouter], prefix: str) -> frozenset[tuple[str, str]]:
    """(method, path) of every route with a body none of whose dependencies refuses who is not known.

    Their paths have no parameters, so that a request is compared with them as they are.
    """
    routes = [route for router in routers for route in router.routes if isinstance(route, APIRoute)]
    open_to_all = [route for route in routes if route.body_field and not any(map(needs_caller, _calls(route)))]
    return frozenset((method, prefix + route.path) for route in open_to_all for method in route.methods or ())


def _calls(route: APIRoute) -> Iterator[object]:
    return (one.call for one in _below(route.dependant))


def _below(dependant: Dependant) -> Iterator[Dependant]:
    yield dependant
    for one in dependant.dependencies:
        yield from _below(one)
