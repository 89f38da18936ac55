"""What browsers load: once, compressed, from here alone, so often and no oftener; nothing runs that is not ours."""

import asyncio
import base64
import hashlib
import json
import re
from collections.abc import Coroutine
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import httpx
import pytest
from fastapi import FastAPI
from fastapi.routing import iter_route_contexts
from playwright.sync_api import expect

from api.middleware.limits import FILES, FILES_SHARE, PROBES, RequestLimits
from services.runtime.database.migrate import upgrade
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings, Settings
from testing.api.process import running_api
from testing.api.serving import Person
from testing.refusals import refused_as
from testing.web.browsing import Site
from testing.web.reading import Reading
from web.assets import BUNDLED, LIBRARIES, built_assets
from web.main import make_site
from web.pages import docs


def test_every_asset_of_a_page_is_there_for_ever_and_compressed(reading: Reading) -> None:
    client = reading.client
    paths = re.findall(r'(?:src|href)="(/assets/[^"]+)"', reading.html("/sign-in"))
    assert len(paths) >= 4
    for path in paths:
        answer = client.get(path, headers={"Accept-Encoding": "gzip"})
        assert (answer.status_code, answer.headers["content-encoding"]) == (200, "gzip")
        assert "immutable" in answer.headers["cache-control"]
        assert client.get(path, headers={"Accept-Encoding": "identity"}).content == answer.content
    other = re.sub(r"/assets/[0-9a-f]+/", "/assets/0000000000000000/", paths[0])
    assert client.get(other).status_code == 404


def test_nothing_else_of_the_folder_is_served(reading: Reading) -> None:
    for path in ("../main.py", "..%2fmain.py", "libraries/../../main.py", "libraries/three/package.json"):
        assert reading.client.get(f"/assets/{built_assets().digest}/{path}").status_code == 404, path


def test_the_import_map_names_our_copies_and_the_policy_lets_only_it_through(reading: Reading) -> None:
    answer = reading.answer("/sign-in")
    (text,) = re.findall(r'<script type="importmap">(.*?)</script>', answer.text)
    imports = json.loads(text)["imports"]
    assert set(imports) == {*LIBRARIES, *BUNDLED}
    assert all(path.startswith("/assets/") for path in imports.values())
    policy = answer.headers["content-security-policy"]
    assert f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" in policy
    assert "unsafe" not in policy


def test_pages_that_were_not_built_are_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: object) -> None:
    monkeypatch.setattr("web.assets.BUILT", tmp_path)
    with refused_as("pages_not_built"):
        built_assets()


def test_script_in_a_name_is_text_and_script_that_was_put_in_does_not_run(site: Site, curator: Person) -> None:
    with site.visit(curator, expected=["Content Security Policy"]) as page:
        page.goto("/account")
        page.evaluate(
            """() => { const one = document.createElement('script'); one.textContent = 'window.ran = true';
                       document.body.append(one); document.body.setAttribute('onclick', 'window.ran = true'); }"""
        )
        page.click("body")
        assert page.evaluate("window.ran") is None


def test_times_are_in_the_readers_zone_and_the_theme_is_remembered(site: Site, curator: Person) -> None:
    with site.visit(curator, timezone_id="Asia/Seoul") as page:
        page.goto("/account")
        assert "stone_zone=Asia/Seoul" in page.evaluate("document.cookie")
        page.get_by_role("button", name="Light or dark").click()
        chosen = page.locator("html").get_attribute("data-theme")
        page.reload()
        expect(page.locator("html")).to_have_attribute("data-theme", chosen or "")


def manual(folder: Path) -> Path:
    """A small manual, as MkDocs writes one: a page with an inline script, a style sheet, a worker."""
    folder.mkdir()
    (folder / "index.html").write_text(
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Docs</title>'
        '<link rel="icon" href="data:,"><link rel="stylesheet" href="site.css">'
        "<script>document.documentElement.dataset.ran = 'yes'</script></head>"
        '<body><h1>The manual</h1><p style="color: green">Styled</p><script src="main.js"></script></body></html>'
    )
    (folder / "site.css").write_text("h1 { color: rgb(1, 2, 3); }")
    (folder / "main.js").write_text("new Worker('search.js').onmessage = m => document.body.dataset.found = m.data;")
    (folder / "search.js").write_text("postMessage('worker');")
    return folder


def test_the_manual_runs_under_its_own_policy(site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(docs, "MANUAL", manual(tmp_path / "manual"))
    with site.visit() as page:
        page.goto("/docs")
        expect(page).to_have_url(f"{site.url}/docs/")
        expect(page.locator("html")).to_have_attribute("data-ran", "yes")
        expect(page.locator("body")).to_have_attribute("data-found", "worker")
        expect(page.get_by_role("heading", name="The manual")).to_have_css("color", "rgb(1, 2, 3)")


SITE = "http://stone.example"
LIMITED = 429
T = TypeVar("T")


@pytest.fixture
def limited(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> FastAPI:
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


def test_every_route_of_the_site_is_counted_but_the_probes(limited: FastAPI) -> None:
    """Catches alone a new page or file that may be asked for without end."""
    routes = {
        (min(route.methods), route.path)
        for route in iter_route_contexts(limited.routes)
        if route.methods and route.path and not route.path.startswith(FILES)
    }
    assert {("GET", "/"), ("GET", "/account"), ("GET", "/sequences/{sequence_id}")} <= routes
    asked = sorted(routes - {("GET", probe) for probe in PROBES})
    first, *answers = apart(statuses(limited, [("GET", "/api/v1/problems"), *asked]))
    assert first == 200
    assert [one for one, status in zip(asked, answers, strict=True) if status != LIMITED] == []


def test_a_page_that_is_asked_for_too_often_says_how_long_to_wait(limited: FastAPI) -> None:
    async def second() -> httpx.Response:
        async with httpx.AsyncClient(transport=httpx.ASGITransport(limited), base_url=SITE) as client:
            shown = {"Accept": "text/html"}
            assert (await client.get("/sign-in", headers=shown)).status_code == 200
            return await client.get("/sign-in", headers=shown)

    refused = apart(second())
    assert refused.status_code == LIMITED
    assert refused.headers["content-type"].startswith("text/html")
    assert 1 <= int(refused.headers["retry-after"]) <= 60


def test_the_files_of_pages_are_counted_apart(limited: FastAPI) -> None:
    path = limited.state.pages.assets.url("app.css")
    answers = apart(statuses(limited, [("GET", "/sign-in"), *[("GET", path)] * (FILES_SHARE + 1)]))
    assert answers == [200, *[200] * FILES_SHARE, LIMITED]


@pytest.mark.whole
def test_pages_that_are_switched_off_are_not_served(tmp_path: Path) -> None:
    """Catches alone a process that serves pages though it was told not to."""
    settings = Settings(data_folder=tmp_path / "data", api=ApiSettings(pages=False))
    upgrade(settings)
    with running_api(settings, tmp_path / "log") as api:
        assert httpx.get(api.url, headers={"Accept": "text/html"}).status_code == 404
        assert httpx.get(f"{api.url}/api/v1/sequences").json()["items"] == []
