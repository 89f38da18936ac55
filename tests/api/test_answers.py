"""What every answer has: tags, compression, releases of clients, names of routes, and the router that finds them."""

import gzip
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import httpx
import pytest
from anyio.from_thread import start_blocking_portal
from fastapi import APIRouter, FastAPI
from fastapi.routing import APIRoute
from starlette.requests import Request
from starlette.routing import Match

from api.client_wheel import FILENAME, OLDEST_CLIENT, ClientWheel, client_wheel, install_line
from api.compression import LEAST_BYTES, tagged_response, takes_gzip
from api.etags import is_unchanged, require_match
from api.main import include, make_api
from api.middleware.entry import template_of
from services.runtime.code_version import RELEASE
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings
from stone_base.releases import HEADER, is_older
from stone_client.release import OLDEST_SERVER, own_release
from testing.api.serving import Person, client_of, serving
from testing.refusals import refused_as
from testing.worlds.made import sequence


def request(**headers: str) -> Request:
    raw = [(name.replace("_", "-").encode(), value.encode("latin-1")) for name, value in headers.items()]
    return Request({"type": "http", "method": "GET", "path": "/", "headers": raw})


@pytest.mark.parametrize("given", ["", '"6"', "7", 'W/"7"', '"77"', '"7', '"', '"6", "8"', "x" * 100_000, '"7 "'])
def test_a_change_that_means_another_state_is_412(given: str) -> None:
    with refused_as("precondition_failed", match='is at "7"'):
        require_match(request(if_match=given), 7)


@pytest.mark.parametrize("given", ['"7"', '"6", "7"', "*", ' "7" '])
def test_a_change_that_means_this_state_passes(given: str) -> None:
    require_match(request(if_match=given), 7)


@pytest.mark.parametrize(("given", "expected"), [
    ('"7"', True), ('W/"7"', True), ('"6", W/"7"', True), ("*", True),
    ("", False), ('"6"', False), ("7", False),
])  # fmt: skip
def test_a_reader_who_has_this_state_is_told_so(given: str, expected: bool) -> None:
    assert is_unchanged(request(if_none_match=given), 7) is expected
    assert not is_unchanged(request(), 7)


URL = "/api/v1/sequences"


def taking(**headers: str) -> Request:
    named = [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()]
    return Request({"type": "http", "method": "GET", "path": "/", "headers": named})


TAKING = ("gzip", "br, gzip;q=0.5", "GZIP", "gzip;q=1.0")
NOT_TAKING = ("", "br", "gzip;q=0", "gzip; q=0.000", "x-gzip")


@pytest.mark.parametrize("said", [*TAKING, *NOT_TAKING])
def test_a_client_takes_what_it_says(said: str) -> None:
    assert takes_gzip(taking(accept_encoding=said)) == (said in TAKING)


@pytest.mark.parametrize("size", [LEAST_BYTES - 1, LEAST_BYTES])
def test_only_what_is_worth_it_is_compressed(size: int) -> None:
    content = b"a" * size
    answer = tagged_response(taking(accept_encoding="gzip"), content, "text/plain")
    is_zipped = answer.headers.get("content-encoding") == "gzip"
    assert is_zipped == (size >= LEAST_BYTES)
    assert (gzip.decompress(answer.body) if is_zipped else answer.body) == content


def test_either_tag_stands_for_what_one_has() -> None:
    content = b"a" * LEAST_BYTES
    tags = {tagged_response(taking(accept_encoding=said), content, "a/b").headers["etag"] for said in ("gzip", "br")}
    assert len(tags) == 2
    for tag in tags:
        for said in ("gzip", "br"):
            answer = tagged_response(taking(if_none_match=tag, accept_encoding=said), content, "a/b")
            assert (answer.status_code, answer.body) == (304, b"")
    assert tagged_response(taking(if_none_match=tags.pop()), b"other" * LEAST_BYTES, "a/b").status_code == 200


def test_a_list_is_the_same_list_compressed_and_who_one_is_is_not_compressed(
    api: httpx.Client, curator: Person
) -> None:
    for number in range(5):
        sequence(api, curator, f"forest-{number}")
    plain = api.get(URL, headers=curator.headers | {"Accept-Encoding": "identity"})
    zipped = api.get(URL, headers=curator.headers | {"Accept-Encoding": "gzip"})
    assert (plain.headers.get("content-encoding"), zipped.headers["content-encoding"]) == (None, "gzip")
    assert plain.content == zipped.content
    assert int(zipped.headers["content-length"]) < int(plain.headers["content-length"]) / 2
    assert "Accept-Encoding" in zipped.headers["vary"]
    assert "content-encoding" not in api.get("/api/v1/me", headers=curator.headers).headers


@pytest.mark.parametrize(
    ("url", "expected"), [("https://stone.example", "max-age=31536000"), ("http://127.0.0.1:8080", None)]
)
def test_the_way_back_is_https_where_the_way_in_was(platform: Platform, url: str, expected: str | None) -> None:
    reached = platform.settings.model_copy(update={"api": ApiSettings(url=url)})
    with client_of(replace(platform, settings=reached)) as api:
        for path in ("/healthz", "/api/v1/me", "/nowhere"):
            assert api.get(path).headers.get("strict-transport-security") == expected


def test_a_client_that_says_no_release_is_understood_and_told_none(api: httpx.Client, participant: Person) -> None:
    """As the release did that came before the header."""
    headers = {**participant.headers, "User-Agent": "stone-client/0.1"}
    answer = api.get("/api/v1/me", headers=headers)
    assert answer.status_code == 200
    assert HEADER not in answer.headers


@pytest.mark.parametrize("release", [OLDEST_CLIENT, RELEASE, "999.0.0", "banana", "9" * 4000])
def test_a_client_that_is_new_enough_or_says_nothing_readable_is_answered_with_ours(
    api: httpx.Client, participant: Person, release: str
) -> None:
    answer = api.get("/api/v1/me", headers={**participant.headers, HEADER: release})
    assert answer.status_code == 200
    assert answer.headers[HEADER] == RELEASE


def test_a_client_that_is_too_old_is_told_the_line_that_installs_the_one_that_fits(
    platform: Platform, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / FILENAME).write_bytes(b"a wheel")
    monkeypatch.setattr("api.main.client_wheel", lambda: client_wheel(tmp_path))
    with serving(platform, make_api(platform)) as url:
        answer = httpx.get(f"{url}/api/v1/me", headers={HEADER: "0.0.9"})
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (426, "client_too_old")
    assert answer.headers["Upgrade"] == f"stone-client/{OLDEST_CLIENT}"
    assert "release 0.0.9" in problem["detail"]
    assert f"pip install {platform.settings.api.url}/downloads/{FILENAME}" in problem["detail"]


def test_what_is_offered_is_said_with_size_and_hash(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    wheel = ClientWheel(FILENAME, b"a wheel")
    monkeypatch.setattr("api.main.client_wheel", lambda: wheel)
    with serving(platform, make_api(platform)) as url:
        record = httpx.get(f"{url}/api/v1/client").json()
    assert (record["release"], record["oldest_client"]) == (RELEASE, OLDEST_CLIENT)
    assert record["wheel"] == {
        "filename": FILENAME,
        "path": f"/downloads/{FILENAME}",
        "size_bytes": 7,
        "sha256": sha256(b"a wheel").hexdigest(),
    }


def test_only_the_wheel_of_this_very_release_is_offered(tmp_path: Path) -> None:
    (tmp_path / "stone_client-0.0.1-py3-none-any.whl").write_bytes(b"an old one")
    assert client_wheel(tmp_path) is None
    assert client_wheel(tmp_path / "absent") is None
    assert install_line("http://server/", None) == "see http://server/downloads/"


def test_client_and_server_of_one_release_understand_each_other() -> None:
    assert own_release() == RELEASE
    assert not is_older(own_release(), OLDEST_CLIENT)
    assert not is_older(RELEASE, OLDEST_SERVER)


@pytest.mark.parametrize(
    ("path", "values", "template"),
    [
        ("/jobs/0a/logs", {"job_id": "0a"}, "/jobs/{job_id}/logs"),
        ("/inputs/n-1.tar", {"name": "n-1"}, "/inputs/{name}.tar"),
        ("/exports/7/files/a/b.c/d.bin", {"id": 7, "path": "a/b.c/d.bin"}, "/exports/{id}/files/{path}"),
        ("/queues/queues/queues", {"queue": "queues", "act": "queues"}, "/queues/{queue}/{act}"),
        ("/phases/m/manifest", {"phase": "m"}, "/phases/{phase}/manifest"),
        ("/a/x.y/x", {"one": "x.y", "two": "x"}, "/a/{one}/{two}"),
        ("/files/", {"path": ""}, "/files/{path}"),
        ("/files/.*[", {"path": ".*["}, "/files/{path}"),
        ("/healthz", {}, "/healthz"),
    ],
)
def test_every_parameter_is_shown_by_its_name(path: str, values: dict[str, Any], template: str) -> None:
    assert template_of({"endpoint": print, "path": path, "path_params": values}) == template


def test_without_a_route_there_is_one_name() -> None:
    assert template_of({"path": "/made/up/by/a/stranger"}) == "unmatched"


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
    jobs, runs, outer, inner = APIRouter(prefix="/jobs"), APIRouter(), APIRouter(), APIRouter()
    for router, path in ((jobs, ""), (jobs, "/{job_id}"), (runs, "/runs"), (runs, "/walks/{name}"), (inner, "/deep")):
        router.get(path)(lambda: "found")
    outer.include_router(inner)
    api = FastAPI()
    for router in (jobs, runs, outer):
        include(api, router, prefix="/api")
    return api


def asked_of(app: FastAPI, path: str, method: str = "GET") -> httpx.Response:
    async def ask() -> httpx.Response:
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://api") as client:
            return await client.request(method, path)

    with start_blocking_portal() as portal:  # a loop of its own: a browser's may run in this thread
        return portal.call(ask)


@pytest.mark.parametrize("path", ["/jobs", "/jobs/1", "/runs", "/walks/jobs", "/deep"])
def test_every_route_is_found(path: str) -> None:
    api = application()
    assert asked_of(api, f"/api{path}").json() == "found"
    assert asked_of(api, f"/api{path}", "POST").status_code == 405
    assert asked_of(api, f"/api{path}/or/not").status_code == 404


def test_a_request_for_another_noun_is_held_against_no_route(monkeypatch: pytest.MonkeyPatch) -> None:
    api, held_against = application(), counted(monkeypatch)
    assert asked_of(api, "/api/runs").json() == "found"
    assert set(held_against) == {"/runs"}


def test_an_application_under_a_path_of_its_own_is_found() -> None:
    outside = FastAPI()
    outside.mount("/lab", application())
    assert asked_of(outside, "/lab/api/jobs/1").json() == "found"
