"""Event streams: what is new is told soon and once, streams end, and many of them cost one query."""

import json
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from threading import Thread
from typing import Any, NamedTuple

import httpx
import pytest
from sqlalchemy import QueuePool, event
from sqlalchemy.exc import OperationalError

from api import event_streams
from api.main import make_api
from services.runtime.access import users
from services.runtime.access.ending import end_all
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.specs import Attempt, Outcome
from services.runtime.orm import Job, User
from services.runtime.platform import Platform
from testing.api.serving import Person, client_of, in_browser, person, serving
from testing.worlds.made import job, run, sequence

Event = tuple[str, str, Any]

JOBS = "/api/v1/jobs"


class Shown(NamedTuple):
    """The headers of a caller without a token."""

    headers: dict[str, str]


SOON_S = 300.0
POLL = "UNION ALL"  # in the statement of every poll, and in no other of these tests


def blocks(lines: Iterator[str]) -> Iterator[dict[str, str]]:
    """The fields of each event; a comment alone is {"": …}."""
    fields: dict[str, str] = {}
    for line in lines:
        if not line:
            yield fields
            fields = {}
            continue
        key, _, value = line.partition(":")
        fields[key] = value.removeprefix(" ")


def listen(api: httpx.Client, path: str, caller: Person, last: str = "", most: int = 100) -> list[Event]:
    """Every event until the stream ends, or the first `most`."""
    heard: list[Event] = []
    hear(api, path, caller, last, heard, most)
    return heard


def hear(api: httpx.Client, path: str, caller: Person | Shown, last: str, heard: list[Event], most: int = 100) -> None:
    """Add each event to `heard` as it comes."""
    headers = caller.headers | ({"Last-Event-ID": last} if last else {})
    with api.stream("GET", path, headers=headers, timeout=SOON_S) as answer:
        assert answer.status_code == 200, answer.read()
        assert answer.headers["content-type"].startswith("text/event-stream")
        for fields in blocks(answer.iter_lines()):
            if "data" in fields:
                heard.append((fields["event"], fields["id"], json.loads(fields["data"])))
            if len(heard) == most:
                return


@contextmanager
def heard_from(api: httpx.Client, path: str, caller: Person | Shown, last: str = "") -> Iterator[list[Event]]:
    """The events so far, while they come; at the end of the block the stream must end by itself."""
    heard: list[Event] = []
    ear = Thread(target=hear, args=(api, path, caller, last, heard), daemon=True)
    ear.start()
    yield heard
    ear.join(SOON_S)
    assert not ear.is_alive(), "the stream goes on after its subject has ended"


def succeed(_attempt: Attempt) -> Outcome:
    return Outcome({})


HANDLERS = {"ingest.ok": succeed, "labeler.ok": succeed}


def touch(platform: Platform, job_id: str, done: int) -> None:
    with platform.database.transaction() as session:
        row = session.get_one(Job, job_id)
        row.done, row.total, row.revision = done, 100, row.revision + 1


def until(is_true: Any, sentence: str) -> None:
    deadline = time.monotonic() + SOON_S
    while not is_true():
        assert time.monotonic() < deadline, sentence
        time.sleep(0.01)


def statements_of(platform: Platform) -> list[str]:
    """The statements that the database gets from here on, as they come."""
    statements: list[str] = []

    def note(*told: Any) -> None:
        statements.extend({told[2]} - {"BEGIN"})

    event.listen(platform.database.engine, "before_cursor_execute", note)
    return statements


def streams_of(api: Any) -> int:
    return int(api.state.follower._streams.total()) if hasattr(api.state, "follower") else 0


def test_a_caller_follows_a_few_streams_and_no_more(
    platform: Platform, curator: Person, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(event_streams, "MAX_PER_CALLER", 2)
    job_id = job(platform, curator, "ingest.ok")
    path = f"{JOBS}/{job_id}/events"
    other = person(platform, "curator")
    with client_of(platform, curator) as api:
        with api.stream("GET", path) as first, api.stream("GET", path) as second:
            assert (first.status_code, second.status_code) == (200, 200)
            third = api.get(path)
            assert (third.status_code, third.json()["code"]) == (429, "too_many_streams")
            assert int(third.headers["retry-after"]) > 0
            theirs = f"{JOBS}/{job(platform, other, 'ingest.ok')}/events"
            with api.stream("GET", theirs, headers=other.headers) as answer:
                assert answer.status_code == 200, "the bound is each caller's own"

        def is_free() -> bool:
            with api.stream("GET", path) as answer:
                return answer.status_code == 200

        until(is_free, "who hangs up has a seat again")


def test_a_job_is_followed_to_its_end(api: httpx.Client, platform: Platform) -> None:
    ada = person(platform, "curator")
    job_id = job(platform, ada, "ingest.ok")
    with heard_from(api, f"{JOBS}/{job_id}/events", ada) as events:
        until(lambda: events, "the standing state comes at once")
        assert run_next(platform, "ingest", HANDLERS)
    names, ids, bodies = zip(*events, strict=True)
    assert names == ("progress",) * (len(names) - 1) + ("ended",)
    assert [int(number) for number in ids] == sorted({int(number) for number in ids})
    assert (bodies[0]["state"], bodies[-1]["state"]) == ("queued", "succeeded")
    assert bodies[-1] == api.get(f"{JOBS}/{job_id}", headers=ada.headers).json()


def test_a_run_moves_when_any_of_its_jobs_does(api: httpx.Client, platform: Platform) -> None:
    ada = person(platform, "curator")
    root_id = run(platform, ada, "ingest.ok", "labeler.ok")
    with heard_from(api, f"{JOBS}/{root_id}/events", ada) as events:
        for done, queue in enumerate(("ingest", "labeler")):
            until(lambda done=done: events and events[-1][2]["progress"]["done"] == done, f"{done} jobs are done")
            assert run_next(platform, queue, HANDLERS)
    assert (events[-1][0], events[-1][2]["progress"]["done"]) == ("ended", 2)


def test_a_child_of_a_run_is_followed_alone(api: httpx.Client, platform: Platform, curator: Person) -> None:
    root_id = run(platform, curator, "ingest.ok", "labeler.ok")
    child = api.get(JOBS, params={"root_id": root_id}, headers=curator.headers).json()["items"][-1]
    with heard_from(api, f"{JOBS}/{child['id']}/events", curator) as events:
        until(lambda: events, "the standing state comes at once")
        assert run_next(platform, "ingest", HANDLERS)
    assert (events[-1][0], events[-1][2]["kind"]) == ("ended", "ingest.ok"), "its run goes on, it does not"


def test_a_broken_stream_goes_on_after_what_was_heard(api: httpx.Client, platform: Platform, curator: Person) -> None:
    job_id = job(platform, curator, "ingest.ok")
    path = f"{JOBS}/{job_id}/events"
    _, last, _ = listen(api, path, curator, most=1)[0]
    with heard_from(api, path, curator, last) as events:
        statements = statements_of(platform)
        # One of them is the route's own, the others are polls.
        until(lambda: sum(POLL in one for one in statements) > 3, "what was heard had its chance to be told again")
        touch(platform, job_id, 7)
        until(lambda: events, "what is new is told")
        name, number, body = events[0]
        told = (name, body["progress"]["done"], int(number))
        assert told == ("progress", 7, int(last) + 1), "what was heard is not told again"
        assert run_next(platform, "ingest", HANDLERS)
    assert listen(api, path, curator, last)[0][2]["state"] == "succeeded", "the missed event comes at once"


def test_who_has_seen_the_end_is_told_to_stay_away(api: httpx.Client, platform: Platform, curator: Person) -> None:
    job_id = job(platform, curator, "ingest.ok")
    assert run_next(platform, "ingest", HANDLERS)
    path = f"{JOBS}/{job_id}/events"
    ((name, last, body),) = listen(api, path, curator)
    assert (name, body["state"]) == ("ended", "succeeded")
    answer = api.get(path, headers=curator.headers | {"Last-Event-ID": last})
    assert (answer.status_code, answer.content) == (204, b"")
    assert len(listen(api, path, curator, "1")) == 1, "who missed the end is told it"


def test_a_sequence_is_followed_through_its_runs_to_its_deletion(api_on: httpx.Client, platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    made = sequence(api_on, ada)
    with heard_from(api_on, f"/api/v1/sequences/{made['id']}/events", ada) as events:
        until(lambda: events, "the standing state comes at once")
        run(platform_on, ada, "ingest.ok", sequence_id=made["id"])
        assert run_next(platform_on, "ingest", HANDLERS)
        until(lambda: (events[-1][2]["job"] or {}).get("state") == "succeeded", "its run is seen to end")
        api_on.delete(f"/api/v1/sequences/{made['id']}", headers=ada.headers | {"If-Match": "*"})
    assert events[0][2]["job"] is None
    assert [name for name, _, _ in events] == ["progress"] * (len(events) - 1) + ["ended"]


def test_progress_is_told_at_most_twice_a_second(api: httpx.Client, platform: Platform, curator: Person) -> None:
    job_id = job(platform, curator, "ingest.ok")
    begin = time.monotonic()
    with heard_from(api, f"{JOBS}/{job_id}/events", curator) as events:
        for done in range(1, 100):
            touch(platform, job_id, done)
        assert run_next(platform, "ingest", HANDLERS)
    assert len(events) <= 2 * (time.monotonic() - begin) + 2


def test_a_stream_outlives_a_database_that_is_away(
    api: httpx.Client, platform: Platform, curator: Person, monkeypatch: pytest.MonkeyPatch
) -> None:
    job_id, asked = job(platform, curator, "ingest.ok"), []

    def away() -> Iterator[None]:
        asked.append(True)
        raise OperationalError("SELECT 1", {}, OSError("connection refused"))

    with heard_from(api, f"{JOBS}/{job_id}/events", curator) as events:
        until(lambda: events, "the standing state comes at once")
        with monkeypatch.context() as patched:
            patched.setattr(platform.database, "reading", contextmanager(away))
            until(lambda: len(asked) > 1, "it asks again")
        assert run_next(platform, "ingest", HANDLERS)
    assert events[-1][0] == "ended"


def test_a_quiet_stream_says_that_it_lives(
    api: httpx.Client, platform: Platform, curator: Person, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("api.routes.events.KEEPALIVE_S", 0.05)
    job_id = job(platform, curator, "ingest.ok")
    with api.stream("GET", f"{JOBS}/{job_id}/events", headers=curator.headers, timeout=SOON_S) as answer:
        comments = 0
        for line in answer.iter_lines():
            comments += line.startswith(":")
            if comments == 3:
                break
    assert comments == 3


def test_a_stream_ends_with_the_token_that_opened_it(api: httpx.Client, platform: Platform) -> None:
    ada = person(platform, "curator", expires_s=4.0)
    begin = time.monotonic()
    heard = listen(api, f"{JOBS}/{job(platform, ada, 'ingest.ok')}/events", ada)
    assert [name for name, _, _ in heard] == ["progress"]
    assert time.monotonic() - begin < SOON_S / 2


@pytest.mark.parametrize("end", ["revoked", "signed out", "shut out", "given away"])
@pytest.mark.parametrize("is_quiet", [False, True])
def test_a_stream_ends_with_its_callers_access(
    api: httpx.Client, platform: Platform, monkeypatch: pytest.MonkeyPatch, end: str, is_quiet: bool
) -> None:
    """The attack: the stream goes on after its token was revoked and its user was shut out."""
    monkeypatch.setattr("api.routes.events.KEEPALIVE_S", 0.2 if is_quiet else SOON_S)
    ada, ben = person(platform, "curator"), person(platform, "curator")
    job_id = job(platform, ada, "ingest.ok")
    headers = in_browser(platform, ada) if end == "signed out" else ada.headers
    with heard_from(api, f"{JOBS}/{job_id}/events", Shown(headers)) as events:
        until(lambda: events, "the standing state comes at once")
        with platform.database.transaction() as session:
            if end == "given away":
                session.get_one(Job, job_id).owner_id = ben.user_id
            elif end == "shut out":
                users.change_user(session, session.get_one(User, ada.user_id), None, is_active=False)
            else:
                end_all(session, ada.user_id)
        if not is_quiet:
            touch(platform, job_id, 7)
    assert [name for name, _, _ in events] == ["progress"], "no later event comes"


def test_the_last_event_of_what_was_given_away_holds_nothing_of_it(
    api: httpx.Client, platform: Platform, curator: Person
) -> None:
    other, job_id = person(platform, "curator"), job(platform, curator, "ingest.ok")
    with heard_from(api, f"{JOBS}/{job_id}/events", curator) as events:
        until(lambda: events, "the standing state comes at once")
        with platform.database.transaction() as session:
            session.get_one(Job, job_id).owner_id = other.user_id
        assert run_next(platform, "ingest", HANDLERS)
    assert [(name, body) for name, _, body in events[1:]] in ([("ended", {})], [])


@pytest.mark.whole
def test_a_hundred_streams_are_one_query_a_tick_and_hold_neither_thread_nor_session(
    platform: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(event_streams, "MAX_PER_CALLER", 100)
    ada, app = person(platform, "curator"), make_api(platform)
    job_ids = [job(platform, ada, "ingest.ok") for _ in range(20)]
    streams: list[list[Event]] = [[] for _ in job_ids * 5]
    many = httpx.Limits(max_connections=200)
    with ThreadPoolExecutor(100) as pool, serving(platform, app) as url, httpx.Client(base_url=url, limits=many) as api:
        for job_id, events in zip(job_ids * 5, streams, strict=True):
            pool.submit(hear, api, f"{JOBS}/{job_id}/events", ada, "", events)
        until(lambda: streams_of(app) == 100, "more streams than the application has threads")
        until(lambda: all(streams), "the standing state comes at once")
        begin = time.monotonic()
        statements = statements_of(platform)
        until(lambda: len(statements) >= 4, "it goes on asking")
        assert len(statements) <= 2 * (time.monotonic() - begin) + 2
        assert all(POLL in statement for statement in statements), "nothing else while nothing moves"
        pool_in_use = platform.database.engine.pool
        assert isinstance(pool_in_use, QueuePool)
        assert pool_in_use.checkedout() <= 1
        while run_next(platform, "ingest", HANDLERS):
            pass
        until(lambda: all(events[-1][0] == "ended" for events in streams), "each stream is told its end")
        until(lambda: streams_of(app) == 0, "every seat is free again")
