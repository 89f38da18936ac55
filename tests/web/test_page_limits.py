"""Pages are counted as the API is: no route of the site answers for ever to whoever asks for ever."""

import asyncio
from collections.abc import Coroutine
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, TypeVar

import httpx
import pytest
from fastapi import FastAPI
from fastapi.routing import iter_route_contexts

from api.middleware.limits import FILES, FILES_SHARE, PROBES, RequestLimits
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings
from web.main import make_site

SITE = "http://stone.example"
LIMITED = 429
T = TypeVar("T")


@pytest.fixture
def site(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> FastAPI:
    """A site of one request a minute, whose clock stands still."""
    monkeypatch.setattr("api.main.RequestLimits", lambda settings: RequestLimits(settings, lambda: 0.0))
    settings = platform.settings.model_copy(update={"api": ApiSettings(requests_per_minute=1)})
    return make_site(replace(platform, settings=settings))


def apart(asking: Coroutine[Any, Any, T]) -> T:
    """What it answers, in a thread of its own: a browser of other tests may have a loop in this one."""
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(asyncio.run, asking).result()


async def statuses(site: FastAPI, asked: list[tuple[str, str]]) -> list[int]:
    transport = httpx.ASGITransport(site, client=("203.0.113.9", 1))
    async with httpx.AsyncClient(transport=transport, base_url=SITE) as client:
        return [(await client.request(method, path)).status_code for method, path in asked]


def test_every_route_of_the_site_is_counted_but_the_probes(site: FastAPI) -> None:
    """Catches alone a new page or file that may be asked for without end."""
    routes = {
        (min(route.methods), route.path)
        for route in iter_route_contexts(site.routes)
        if route.methods and route.path and not route.path.startswith(FILES)
    }
    assert {("GET", "/"), ("GET", "/account"), ("GET", "/sequences/{sequence_id}")} <= routes
    asked = sorted(routes - {("GET", probe) for probe in PROBES})
    first, *answers = apart(statuses(site, [("GET", "/api/v1/problems"), *asked]))
    assert first == 200
    assert [one for one, status in zip(asked, answers, strict=True) if status != LIMITED] == []


def test_a_page_that_is_asked_for_too_often_says_how_long_to_wait(site: FastAPI) -> None:
    async def second() -> httpx.Response:
        async with httpx.AsyncClient(transport=httpx.ASGITransport(site), base_url=SITE) as client:
            shown = {"Accept": "text/html"}
            assert (await client.get("/sign-in", headers=shown)).status_code == 200
            return await client.get("/sign-in", headers=shown)

    refused = apart(second())
    assert refused.status_code == LIMITED
    assert refused.headers["content-type"].startswith("text/html")
    assert 1 <= int(refused.headers["retry-after"]) <= 60


def test_the_files_of_pages_are_counted_apart(site: FastAPI) -> None:
    path = site.state.pages.assets.url("app.css")
    answers = apart(statuses(site, [("GET", "/sign-in"), *[("GET", path)] * (FILES_SHARE + 1)]))
    assert answers == [200, *[200] * FILES_SHARE, LIMITED]


def test_probes_are_not_counted(site: FastAPI) -> None:
    assert apart(statuses(site, [("GET", "/healthz")] * 5)) == [200] * 5
