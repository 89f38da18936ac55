"""A router of one noun's routes, which is passed over by requests for other nouns.

**Conventions.** Routers are asked one after another, and each looks at all of its routes: without this, a request of
the last noun is held against every path of the API, for a quarter of what a list costs.
"""

from typing import Any

from fastapi import APIRouter
from starlette.routing import Match
from starlette.types import Scope


class NounRouter(APIRouter):
    """An `APIRouter` that knows with which words its paths begin."""

    def __init__(self, **options: Any) -> None:
        self._words = set[str]()
        super().__init__(**options)

    def add_api_route(self, path: str, *given: Any, **options: Any) -> None:
        self._words.add(first_word(f"{self.prefix}{path}"))
        super().add_api_route(path, *given, **options)

    def include_router(self, router: APIRouter, **options: Any) -> None:
        self._words.add("/")  # whatever the other one holds
        super().include_router(router, **options)

    def matches(self, scope: Scope) -> tuple[Match, Scope]:
        path = scope.get("path", "")
        for word in self._words:
            if word in path:
                return super().matches(scope)
        return Match.NONE, {}


def first_word(path: str) -> str:
    """The first segment of a route's path with its slash, of `/jobs/{job_id}` `/jobs`; `/` where it is a parameter."""
    return f"/{path.split('/', 2)[1].partition('{')[0]}"
