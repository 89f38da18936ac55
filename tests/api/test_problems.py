"""Whatever is not answered as asked is answered by a problem, which says why and nothing of our insides."""

import errno
import re
import sqlite3
from collections.abc import Iterator, MutableMapping
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import APIRouter
from sqlalchemy import event, text
from structlog.contextvars import merge_contextvars
from structlog.testing import capture_logs

from api import problems, statuses
from api.main import make_api
from api.problems import MEDIA_TYPE, Problem
from services.runtime.platform import Platform
from services.runtime.settings import DatabaseSettings
from stone.errors import StoneError
from testing.api.serving import Person, client_of, serving
from testing.servers.fixtures import make_settings, opened

SECRET = "hunter2-hunter2-hunter2"


class UnlistedError(StoneError):
    """Nobody gave this a status."""

    code = "unlisted"

    def __init__(self) -> None:
        super().__init__(f"the password is {SECRET}")


faulty = APIRouter()


@faulty.get("/fault/{kind}")
def fail(kind: str) -> None:
    faults: dict[str, Exception] = {
        "bug": RuntimeError(SECRET),
        "unlisted": UnlistedError(),
        "full": OSError(errno.ENOSPC, SECRET),
        "disk": OSError(errno.EIO, SECRET),
    }
    raise faults[kind]


@pytest.fixture
def said() -> Iterator[list[MutableMapping[str, Any]]]:
    """What was logged meanwhile, unrendered."""
    with capture_logs(processors=[merge_contextvars]) as lines:
        yield lines


@pytest.fixture
def broken(platform: Platform, said: list[MutableMapping[str, Any]]) -> Iterator[httpx.Client]:
    app = make_api(platform)
    app.include_router(faulty)
    with serving(platform, app) as url, httpx.Client(base_url=url, timeout=300) as client:
        yield client


def problem_of(answer: httpx.Response, status: int, code: str) -> Problem:
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == MEDIA_TYPE
    assert answer.headers["cache-control"] == "no-store"
    problem = Problem.model_validate(answer.json())
    assert (problem.status, problem.code) == (status, code)
    assert problem.request_id == answer.headers["x-request-id"]
    return problem


def test_an_unknown_route_is_404_as_a_problem(api: httpx.Client) -> None:
    problem_of(api.get("/api/v1/nothing"), 404, "not_found")
    problem_of(api.get("/"), 404, "not_found")


def test_an_unknown_method_is_405_and_names_the_known_ones(api: httpx.Client) -> None:
    for path, methods in (
        ("/api/v1/me", "GET"),
        ("/api/v1/tokens", "GET, POST"),
        (f"/api/v1/sequences/{'0' * 32}", "DELETE, GET, PATCH"),
        ("/healthz", "GET"),
    ):
        answer = api.put(path)
        problem_of(answer, 405, "method_not_allowed")
        assert answer.headers["allow"] == methods


def test_a_body_that_is_no_json_is_415(api: httpx.Client) -> None:
    for kind in ("text/plain", "application/x-www-form-urlencoded"):  # the second is what `curl -d` sends
        answer = api.post("/api/v1/sessions", content=b"{}", headers={"Content-Type": kind})
        problem = problem_of(answer, 415, "unsupported_media_type")
        assert problem.detail.endswith("send 'Content-Type: application/json'")


def test_a_body_that_cannot_be_read_is_refused(api: httpx.Client) -> None:
    for content, status in [
        (b"{", 422),
        (b"\xff\xff", 400),
        (b"[" * 10_000, 400),
        (b'{"name": ' + b"9" * 5000 + b"}", 400),
        (b"", 422),
        (b"null", 422),
        (b"[]", 422),
        (b'{"name": "\\ud800", "password": "x"}', 422),
        (b'{"name": NaN, "password": "x"}', 422),
    ]:
        answer = api.post("/api/v1/sessions", content=content, headers={"Content-Type": "application/json"})
        assert answer.status_code == status, answer.text
        assert answer.headers["content-type"] == MEDIA_TYPE


def test_what_is_wrong_in_a_body_is_said_without_repeating_it(api: httpx.Client) -> None:
    answer = api.post("/api/v1/sessions", json={"name": 7, "password": {"deep": SECRET}, "extra": SECRET})
    problem = problem_of(answer, 422, "invalid_request")
    assert {finding.where for finding in problem.errors} == {"body.name", "body.password", "body.extra"}
    assert problem.errors_total == 3
    assert SECRET not in answer.text


WRONG: list[tuple[str, dict[str, Any], str, str]] = [
    ("tokens", {"scopes": ["read"]}, "a value", "nothing"),
    ("tokens", {"name": 7, "scopes": ["read"]}, "text", "a number"),
    ("tokens", {"name": SECRET * 9, "scopes": ["read"]}, "at most 64 character(s)", "text of 207 character(s)"),
    ("tokens", {"name": "a", "scopes": [SECRET]}, "one of 'read', ", f"text of {len(SECRET)} character(s)"),
    ("tokens", {"name": "a", "scopes": "read"}, "a list", "text of 4 character(s)"),
    ("tokens", {"name": "a", "scopes": ["read"], "expires_s": 0}, "at least 1", "0"),
    ("tokens", {"name": "a", "scopes": True}, "a list", "true or false"),
    ("tokens", {"name": "a", "scopes": ["read"], "expires_s": {SECRET: 1}}, "a number", "an object of 1 key(s)"),
]


@pytest.mark.parametrize(("path", "body", "expected", "actual"), WRONG)
def test_a_finding_holds_what_is_expected_and_what_kind_of_thing_was_sent(
    platform: Platform, curator: Person, path: str, body: dict[str, Any], expected: str, actual: str
) -> None:
    with client_of(platform, curator) as api:
        answer = api.post(f"/api/v1/{path}", json=body)
    (finding,) = problem_of(answer, 422, "invalid_request").errors
    assert finding.expected is not None
    assert finding.expected.startswith(expected)
    assert finding.actual == actual
    assert finding.detail == f"expected {finding.expected}; found {actual}"
    assert SECRET not in answer.text


def test_words_of_pydantic_stay_inside(platform: Platform, curator: Person) -> None:
    with client_of(platform, curator) as api:
        key = api.post("/api/v1/tokens", json={"name": "a", "scopes": ["read"], "more": 1})
        json = api.post("/api/v1/tokens", content=b"{", headers={"Content-Type": "application/json"})
        limit = api.get("/api/v1/tokens", params={"limit": "500"})
        cursor = api.get("/api/v1/jobs", params={"sequence_id": "nope"})
    found = [(one.where, one.expected, one.actual) for answer in (key, json, limit, cursor)
             for one in Problem.model_validate(answer.json()).errors]  # fmt: skip
    assert found == [
        ("body.more", "a known key", None),
        ("body.1", "JSON", "invalid JSON at character 1"),
        ("query.limit", "at most 200", "500"),
        ("query.sequence_id", "an id of 32 hexadecimal digits", "text of 4 character(s)"),
    ]


def test_a_body_with_a_thousand_mistakes_is_answered_in_bounded_length(platform: Platform, curator: Person) -> None:
    with client_of(platform, curator) as api:
        answer = api.post("/api/v1/teams", json={f"{'key' * 50}{n}": n for n in range(1000)})
    problem = problem_of(answer, 422, "invalid_request")
    assert (len(problem.errors), problem.errors_total) == (100, 1001)
    assert len(answer.content) < 40_000


def test_a_body_is_bounded_by_what_its_head_says(platform: Platform) -> None:
    limit = platform.settings.api.body_bytes
    with client_of(platform) as api:
        answer = api.post("/api/v1/sessions", content=b" " * (limit + 1), headers={"Content-Type": "application/json"})
        problem_of(answer, 413, "body_too_large")


def test_a_body_is_bounded_by_what_comes_when_its_head_says_nothing(platform: Platform) -> None:
    pieces = (b" " * 65536 for _ in range(64))
    with client_of(platform) as api:
        answer = api.post("/api/v1/sessions", content=pieces, headers={"Content-Type": "application/json"})
        problem_of(answer, 413, "body_too_large")


def test_no_type_of_body_gets_around_the_limit(api: httpx.Client) -> None:
    for path in ["/api/v1/sessions", "/api/v1/calibrations", "/api/v1/uploadsx", "/api/v1/nothing"]:
        for kind in ["multipart/form-data; boundary=b", "application/offset+octet-stream", "", "text/plain"]:
            answer = api.post(path, content=b" " * (2 * 2**20 + 1), headers={"Content-Type": kind})
            problem_of(answer, 413, "body_too_large")


def test_a_repeated_request_is_bounded_too(platform: Platform, curator: Person) -> None:
    with client_of(platform, curator) as api:
        headers = {"Content-Type": "application/json", "Idempotency-Key": "k"}
        answer = api.post("/api/v1/teams", content=(b" " * 65536 for _ in range(64)), headers=headers)
        problem_of(answer, 413, "body_too_large")


def test_a_fault_shows_its_request_and_nothing_of_our_insides(broken: httpx.Client) -> None:
    for kind, status, code in [
        ("bug", 500, "internal_error"),
        ("unlisted", 500, "internal_error"),
        ("disk", 500, "internal_error"),
        ("full", 507, "insufficient_storage"),
    ]:
        answer = broken.get(f"/fault/{kind}", headers={"X-Request-ID": "mine-7"})
        assert problem_of(answer, status, code).request_id == "mine-7"
        assert SECRET not in answer.text
        assert "OSError" not in answer.text
        assert "Traceback" not in answer.text


def test_a_fault_is_logged_with_its_request(broken: httpx.Client, said: list[MutableMapping[str, Any]]) -> None:
    broken.get("/fault/bug", headers={"X-Request-ID": "look-for-me"})
    fault = next(line for line in said if line["event"] == "unhandled exception")
    assert fault["request_id"] == "look-for-me"
    assert isinstance(fault["exc_info"], RuntimeError)


def test_without_its_database_the_api_lives_and_answers_503(tmp_path: Path) -> None:
    away = make_settings(tmp_path, database=DatabaseSettings("postgresql://nobody@127.0.0.1:1/nothing"))
    with client_of(opened(away, [])) as api:
        assert api.get("/healthz").status_code == 200
        answer = api.get("/api/v1/me", headers={"Authorization": "Bearer stone_" + "x" * 43})
        problem_of(answer, 503, "database_unavailable")
        assert answer.headers["retry-after"] == "2"


def test_a_database_whose_disk_is_full_is_507_and_writes_nothing(platform: Platform, curator: Person) -> None:
    def fill(connection: Any, _record: object) -> None:
        connection.execute("PRAGMA max_page_count=1")

    with client_of(platform, curator) as api:
        assert api.get("/api/v1/me").status_code == 200
        platform.database.engine.dispose()
        event.listen(platform.database.engine, "connect", fill)
        refused = [api.post("/api/v1/teams", json={"name": f"{n} {'x' * 50}"}) for n in range(60)]
        full = [answer for answer in refused if answer.status_code != 201]
        assert full, "the pages that were there took everything"
        problem_of(full[0], 507, "insufficient_storage")
        event.remove(platform.database.engine, "connect", fill)
        platform.database.engine.dispose()
        assert api.post("/api/v1/teams", json={"name": "after"}).status_code == 201


def test_a_locked_database_is_503(platform: Platform, curator: Person, tmp_path: Path) -> None:
    hurried = opened(make_settings(tmp_path, database=DatabaseSettings(busy_timeout_s=0.05)), [])
    with client_of(hurried, curator) as api:
        assert api.get("/api/v1/me").status_code == 200
        with sqlite3.connect(platform.settings.root / "stone.sqlite3", isolation_level=None) as other:
            other.execute("BEGIN IMMEDIATE")
            problem_of(api.post("/api/v1/teams", json={"name": "late"}), 503, "database_unavailable")
            other.execute("ROLLBACK")
        other.close()
        assert api.post("/api/v1/teams", json={"name": "late"}).status_code == 201


def test_a_database_older_than_the_code_is_a_fault_not_an_outage(platform_on: Platform, curator: Person) -> None:
    with platform_on.database.transaction() as session:
        session.execute(text("ALTER TABLE users RENAME TO users_of_yesterday"))
    with client_of(platform_on, curator) as api:
        problem_of(api.get("/api/v1/me"), 500, "internal_error")


def test_every_answer_has_the_security_headers_and_none_names_the_server(api: httpx.Client) -> None:
    for path in ("/healthz", "/api/v1/me", "/nothing", "/api/v1/openapi.json"):
        headers = api.get(path).headers
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert "frame-ancestors 'none'" in headers["content-security-policy"]
        assert "version" not in str(headers).lower()


def test_a_request_keeps_the_id_it_brings(api: httpx.Client) -> None:
    for offered in ["abc-123", "x" * 64]:
        assert api.get("/healthz", headers={"X-Request-ID": offered}).headers["x-request-id"] == offered


def test_a_request_whose_id_is_none_is_given_one(api: httpx.Client) -> None:
    for offered in ["", "x" * 65, "a b", "a;b", "<script>", "a\tb"]:
        assert re.fullmatch(
            "[0-9a-f]{32}", api.get("/healthz", headers={"X-Request-ID": offered}).headers["x-request-id"]
        )


def test_the_access_log_names_route_and_caller_and_no_secret(
    platform: Platform, curator: Person, said: list[MutableMapping[str, Any]]
) -> None:
    with client_of(platform, curator) as api:
        api.get("/api/v1/problems/not_found?token=" + SECRET)
        api.get("/api/v1/me?token=" + SECRET)
    first, second = (line for line in said if line["event"] == "request")
    assert (first["route"], first["status"], first["method"]) == ("/api/v1/problems/{code}", 422, "GET")
    assert (second["route"], second["caller"]) == ("/api/v1/me", curator.name)
    assert SECRET not in str(said)
    assert curator.secret not in str(said)


def test_every_refusal_of_ours_has_a_status_and_a_title() -> None:
    for code, (status, title) in statuses.PROBLEM_TYPES.items():
        assert 400 <= status < 600, code
        assert statuses.phrase_of(status)
        assert title, code


def test_a_problem_says_where_its_kind_is_described(api: httpx.Client) -> None:
    kind = api.get("/api/v1/me").json()["type"]
    described = api.get(kind).json()
    assert (described["code"], described["status"]) == ("unauthenticated", 401)
    problem_of(api.get("/api/v1/problems/none-such"), 404, "not_found")


def test_every_code_has_one_title_and_a_page(api: httpx.Client) -> None:
    items = api.get("/api/v1/problems").json()["items"]
    listed = {item["code"]: item["title"] for item in items}
    assert len(listed) == len(items)
    for answer in (api.get("/api/v1/nothing"), api.put("/api/v1/me"), api.get(f"/api/v1/jobs/{'0' * 32}")):
        said = answer.json()
        assert listed[said["code"]] == said["title"]
    raised = set(re.findall(r'problem\("(\w+)"', Path(problems.__file__).read_text("utf-8")))
    assert len(raised) >= 7
    assert raised <= set(listed)
