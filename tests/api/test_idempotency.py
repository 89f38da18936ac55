"""A creating request sent twice creates once, whatever happens between the two."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import httpx
import pytest
from fastapi import APIRouter, Response
from sqlalchemy import func, select, update
from sqlalchemy.exc import OperationalError
from structlog.testing import capture_logs

from api.main import make_api
from api.middleware import idempotency
from api.middleware.idempotency import KEPT_NS, IdempotentRequest, StoredReply
from services.runtime.database.transactions import Database
from services.runtime.orm import IdempotentReply, Team, User
from services.runtime.platform import Platform
from testing.api.serving import Person, at_once, in_browser, person, serving
from testing.refusals import refused_as

TEAMS = "/api/v1/teams"
Faulty = tuple[httpx.Client, list[str]]


@pytest.fixture
def ada(platform_on: Platform) -> Person:
    return person(platform_on, "administrator")


@pytest.fixture
def lone(platform: Platform) -> Person:
    return person(platform, "administrator")


def teams_in(platform: Platform) -> int:
    with platform.database.reading() as session:
        return session.scalar(select(func.count()).select_from(Team)) or 0


def rows_in(platform: Platform) -> list[IdempotentReply]:
    with platform.database.reading() as session:
        return list(session.scalars(select(IdempotentReply)))


def found(api: httpx.Client, caller: Person, key: str, name: str = "us", **more: Any) -> httpx.Response:
    return api.post(TEAMS, json={"name": name}, headers={**caller.headers, "Idempotency-Key": key}, **more)


def test_what_is_no_key_is_422(api: httpx.Client, participant: Person) -> None:
    for key in ["", "x" * 129, "a\tb", "é", "a b"]:
        headers = [
            (b"Authorization", participant.headers["Authorization"].encode()),
            (b"Idempotency-Key", key.encode()),
        ]
        answer = api.post(TEAMS, json={"name": "us"}, headers=headers)
        assert (answer.status_code, answer.json()["code"]) == (422, "bad_idempotency_key")


def test_the_same_key_with_another_request_is_422_and_changes_nothing(
    api: httpx.Client, platform: Platform, lone: Person
) -> None:
    assert found(api, lone, "k").status_code == 201
    for answer in (found(api, lone, "k", name="them"), found(api, lone, "k", params={"x": "1"})):
        assert (answer.status_code, answer.json()["code"]) == (422, "idempotency_key_reused")
    assert teams_in(platform) == 1


def test_a_repeated_request_creates_once_and_is_answered_the_same(
    api: httpx.Client, platform: Platform, lone: Person
) -> None:
    first, second = (found(api, lone, "k") for _ in range(2))
    assert (first.status_code, second.status_code) == (201, 201)
    assert first.content == second.content
    assert "idempotency-replayed" not in first.headers
    assert second.headers["idempotency-replayed"] == "true"
    assert second.headers["content-type"] == "application/json"
    assert second.headers["x-request-id"] != first.headers["x-request-id"]
    assert teams_in(platform) == 1


def test_keys_are_their_callers_own_and_their_routes_own(api: httpx.Client, platform: Platform, lone: Person) -> None:
    eve = person(platform, "participant")
    assert found(api, lone, "k").status_code == 201
    assert found(api, eve, "k", name="them").status_code == 201
    headers = {**lone.headers, "Idempotency-Key": "k"}
    user = {"name": "bob", "role": "curator", "reason": "joins"}
    assert api.post("/api/v1/admin/users", json=user, headers=headers).status_code == 201


def test_an_answer_is_not_repeated_to_a_credential_that_may_do_less(
    api: httpx.Client, platform: Platform, lone: Person
) -> None:
    """The attack: a token for reading, or a cookie without its CSRF token, gets the stored 201 of another request."""
    key = {"Idempotency-Key": "k"}
    user = {"name": "bob", "role": "curator", "reason": "joins"}
    asked = partial(api.post, "/api/v1/admin/users", json=user)
    assert asked(headers=lone.headers | key).status_code == 201
    read_only = {"name": "reads", "scopes": ["read"]}
    reader = api.post("/api/v1/tokens", json=read_only, headers=lone.headers).json()["secret"]
    refused = asked(headers={"Authorization": f"Bearer {reader}", **key})
    assert (refused.status_code, refused.json()["code"]) == (403, "forbidden")
    browser = in_browser(platform, lone)
    forged = asked(headers={"Cookie": browser["Cookie"], **key})
    assert (forged.status_code, forged.json()["code"]) == (403, "csrf")
    again = asked(headers=browser | key)
    assert (again.status_code, again.headers["idempotency-replayed"]) == (201, "true")
    api.cookies.clear()
    with platform.database.transaction() as session:
        session.execute(update(User).where(User.id == lone.user_id).values(role="curator"))
    lost = asked(headers=lone.headers | key)
    assert (lost.status_code, lost.json()["code"]) == (403, "forbidden")


def test_a_refused_request_is_worked_on_again(api: httpx.Client, platform: Platform, lone: Person) -> None:
    assert found(api, lone, "k", name="").status_code == 422
    assert found(api, lone, "k").status_code == 201
    assert found(api, lone, "other").status_code == 409
    assert [row.status for row in rows_in(platform)] == [201]


def test_a_secret_is_not_kept_and_its_repetition_says_so(api: httpx.Client, platform: Platform, lone: Person) -> None:
    headers = {**lone.headers, "Idempotency-Key": "k"}
    first, second = (api.post("/api/v1/tokens", json={"name": "x"}, headers=headers) for _ in range(2))
    assert first.status_code == 201
    assert (second.status_code, second.json()["code"]) == (409, "reply_not_kept")
    assert len(api.get("/api/v1/tokens", headers=lone.headers).json()["items"]) == 2
    assert first.json()["secret"].encode() not in b"".join(row.body for row in rows_in(platform))


def test_of_twenty_equal_requests_at_once_one_creates(api_on: httpx.Client, platform_on: Platform, ada: Person) -> None:
    answers = at_once(str(api_on.base_url), 20, lambda client, _: found(client, ada, "k"))
    assert teams_in(platform_on) == 1
    fresh = [answer for answer in answers if answer.status_code == 201 and "idempotency-replayed" not in answer.headers]
    assert len(fresh) == 1
    for answer in answers:
        is_replayed = answer.status_code == 201 and answer.content == fresh[0].content
        is_in_flight = answer.status_code == 409 and answer.json()["code"] == "request_in_flight"
        assert is_replayed or is_in_flight, answer.text
    assert found(api_on, ada, "k").content == fresh[0].content


@pytest.fixture
def faulty(platform: Platform) -> Iterator[Faulty]:
    """A served application with a route that founds a team and then does what the test asks."""
    plan: list[str] = []
    router = APIRouter()

    @router.post("/api/v1/faulty")
    def work() -> Response:
        asked = plan.pop(0)
        if asked == "bug before":
            raise RuntimeError("a fault of ours")
        with platform.database.transaction() as session:
            session.add(Team(name="made"))
        if asked == "bug after":
            raise RuntimeError("a fault of ours")
        return Response(b"x" * (70_000 if asked == "large answer" else 7), 201)

    app = make_api(platform)
    app.include_router(router)
    with serving(platform, app) as url, httpx.Client(base_url=url, timeout=300) as client:
        yield client, plan


def test_a_fault_before_any_effect_is_forgotten(faulty: Faulty, platform: Platform, lone: Person) -> None:
    client, plan = faulty
    plan.append("bug before")
    headers = {**lone.headers, "Idempotency-Key": "k"}
    with capture_logs():
        assert client.post("/api/v1/faulty", headers=headers).status_code == 500
    assert rows_in(platform) == []


def test_a_fault_after_the_effect_is_never_worked_on_again(faulty: Faulty, platform: Platform, lone: Person) -> None:
    client, plan = faulty
    plan.append("bug after")
    headers = {**lone.headers, "Idempotency-Key": "k"}
    with capture_logs():
        assert client.post("/api/v1/faulty", headers=headers).status_code == 500
    again = client.post("/api/v1/faulty", headers=headers)
    assert (again.status_code, again.json()["code"]) == (409, "reply_not_kept")
    assert teams_in(platform) == 1


def test_an_answer_waits_for_a_database_that_is_away_for_a_moment(
    faulty: Faulty, platform: Platform, lone: Person, monkeypatch: pytest.MonkeyPatch
) -> None:
    client, plan = faulty
    plan.append("answer")
    outages, keep = [1, 2, 3], idempotency.keep

    def keep_after_the_outage(database: Database, row_id: str, reply: StoredReply | None) -> None:
        if outages:
            raise OperationalError("UPDATE", {}, RuntimeError(f"the server is away, {outages.pop()}"))
        keep(database, row_id, reply)

    monkeypatch.setattr(idempotency, "keep", keep_after_the_outage)
    headers = {**lone.headers, "Idempotency-Key": "k"}
    first, second = (client.post("/api/v1/faulty", headers=headers) for _ in range(2))
    assert (first.status_code, second.status_code, outages) == (201, 201, [])
    assert second.headers["idempotency-replayed"] == "true"
    assert teams_in(platform) == 1


def test_an_answer_too_large_to_keep_goes_out_whole_and_is_not_repeated(
    faulty: Faulty, platform: Platform, lone: Person
) -> None:
    client, plan = faulty
    plan.append("large answer")
    headers = {**lone.headers, "Idempotency-Key": "k"}
    assert len(client.post("/api/v1/faulty", headers=headers).content) == 70_000
    again = client.post("/api/v1/faulty", headers=headers)
    assert (again.status_code, again.json()["code"]) == (409, "reply_not_kept")
    assert teams_in(platform) == 1


def asked_by(caller: Person, sha256: str = "a" * 64, lease_ns: int = 10**12) -> IdempotentRequest:
    return IdempotentRequest(caller.user_id, TEAMS, "k", sha256, lease_ns)


def test_a_request_whose_process_died_before_its_commit_is_worked_on_again_after_the_lease(
    platform_on: Platform, ada: Person
) -> None:
    database = platform_on.database
    row_id = idempotency.reserve(database, asked_by(ada))
    with refused_as("request_in_flight"):
        idempotency.reserve(database, asked_by(ada))
    assert idempotency.reserve(database, asked_by(ada, lease_ns=0)) == row_id


def test_a_request_whose_process_died_after_its_commit_is_never_worked_on_again(
    platform_on: Platform, ada: Person
) -> None:
    database = platform_on.database
    row_id = idempotency.reserve(database, asked_by(ada))
    assert isinstance(row_id, str)
    mark = idempotency.working_for.set(row_id)
    with database.transaction() as session:
        session.add(Team(name="made"))
    idempotency.working_for.reset(mark)
    with refused_as("request_in_flight"):
        idempotency.reserve(database, asked_by(ada))
    with refused_as("reply_not_kept"):
        idempotency.reserve(database, asked_by(ada, lease_ns=0))


def test_what_was_rolled_back_is_not_marked_as_done(platform: Platform, lone: Person) -> None:
    database = platform.database
    row_id = idempotency.reserve(database, asked_by(lone))
    assert isinstance(row_id, str)
    mark = idempotency.working_for.set(row_id)
    with database.transaction() as session:
        session.add(Team(name="made"))
        session.flush()
        session.rollback()
    idempotency.working_for.reset(mark)
    assert [row.status for row in rows_in(platform)] == [idempotency.IN_WORK]


def test_a_day_later_the_key_is_free(api: httpx.Client, platform: Platform, lone: Person) -> None:
    assert found(api, lone, "k").status_code == 201
    with platform.database.transaction() as session:
        session.execute(update(IdempotentReply).values(created_ns=IdempotentReply.created_ns - KEPT_NS - 10**9))
    assert found(api, lone, "k", name="them").status_code == 201
    assert len(rows_in(platform)) == 1
