"""Routers that are passed over: by requests for other nouns, and by none for their own."""

from typing import Any

import httpx
import pytest
from anyio.from_thread import start_blocking_portal
from fastapi import FastAPI
from fastapi.routing import APIRoute
from starlette.routing import Match

from api.noun_router import NounRouter, first_word


@pytest.mark.parametrize(
    ("path", "word"),
    [("/jobs", "/jobs"), ("/jobs/{job_id}/logs", "/jobs"), ("/a.{form}", "/a."), ("/{name}", "/"), ("/", "/")],
)
def test_the_word_of_a_path_is_its_literal_beginning(path: str, word: str) -> None:
    assert first_word(path) == word


def counted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The paths that its routes are held against."""
    paths: list[str] = []
    matches = APIRoute.matches

    def noting(self: APIRoute, scope: Any) -> tuple[Match, Any]:
        paths.append(self.path)
        return matches(self, scope)

    monkeypatch.setattr(APIRoute, "matches", noting)
    return paths


def application() -> FastAPI:
    """Jobs, runs, and what is within another router, all under a prefix."""
    jobs, runs, outer, inner = NounRouter(prefix="/jobs"), NounRouter(), NounRouter(), NounRouter()
    for router, path in ((jobs, ""), (jobs, "/{job_id}"), (runs, "/runs"), (runs, "/walks/{name}"), (inner, "/deep")):
        router.get(path)(lambda: "found")
    outer.include_router(inner)
    api = FastAPI()
    for router in (jobs, runs, outer):
        api.include_router(router, prefix="/api")
    return api


def asked(app: FastAPI, path: str, method: str = "GET") -> httpx.Response:
    async def ask() -> httpx.Response:
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://api") as client:
            return await client.request(method, path)

    with start_blocking_portal() as portal:  # a loop of its own: a browser's may run in this thread
        return portal.call(ask)


@pytest.mark.parametrize("path", ["/jobs", "/jobs/1", "/runs", "/walks/jobs", "/deep"])
def test_every_route_is_found(path: str) -> None:
    api = application()
    assert asked(api, f"/api{path}").json() == "found"
    assert asked(api, f"/api{path}", "POST").status_code == 405
    assert asked(api, f"/api{path}/or/not").status_code == 404


def test_a_request_for_another_noun_is_held_against_no_route(monkeypatch: pytest.MonkeyPatch) -> None:
    api, held_against = application(), counted(monkeypatch)
    assert asked(api, "/api/runs").json() == "found"
    assert set(held_against) == {"/runs"}


def test_an_application_under_a_path_of_its_own_is_found() -> None:
    outside = FastAPI()
    outside.mount("/lab", application())
    assert asked(outside, "/lab/api/jobs/1").json() == "found"
