"""Many jobs at once: found, counted and steered by an administrator, with what came of each."""

from typing import Any

import httpx
import pytest
from sqlalchemy import event, select, update

from api.routes.admin.admin_jobs import AdminFilters
from api.views.admin import job_counts
from api.views.queues import queue_items
from benchmarks.dashboard.rows import fill
from services.domain.notifications.messages import message_of
from services.runtime.jobs.claims import claim
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.worker_presence import WorkerHeartbeat
from services.runtime.notifications.events import RUN_FAILED
from services.runtime.orm import AuditEntry, Job, NotificationEvent
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from testing.api.serving import Person, person
from testing.worlds.made import NOBODY, job, row_of, run, sequence
from tests.api.test_jobs import HANDLERS, ids, run_all

ADMIN = "/api/v1/admin"
WHY = "the disk was full"


def ask(api: httpx.Client, caller: Person, path: str, **query: Any) -> Any:
    answer = api.get(ADMIN + path, params=query, headers=caller.headers)
    assert answer.status_code == 200, answer.text
    return answer.json()


def acts(api: httpx.Client, caller: Person, act: str, *job_ids: str) -> list[dict[str, Any]]:
    body = {"act": act, "job_ids": list(job_ids), "reason": WHY}
    answer = api.post(f"{ADMIN}/jobs/acts", json=body, headers=caller.headers)
    assert answer.status_code == 200, answer.text
    items: list[dict[str, Any]] = answer.json()
    return items


def exhaust(platform: Platform, job_id: str) -> None:
    with platform.database.transaction() as session:
        session.execute(update(Job).where(Job.id == job_id).values(attempts_left=0))


def test_each_of_many_is_done_or_says_why_not(api_on: httpx.Client, platform_on: Platform) -> None:
    ada, admin = person(platform_on, "curator"), person(platform_on, "administrator")
    refused, spoke = job(platform_on, ada, "ingest.refuse"), job(platform_on, ada, "ingest.speak")
    run_all(platform_on)
    queued = job(platform_on, ada, "ingest.speak")
    items = acts(api_on, admin, "retry", refused, spoke, NOBODY, queued, refused)
    assert [(one["job_id"], one["state"]) for one in items] == [
        (refused, "queued"), (spoke, None), (NOBODY, None), (queued, None),
    ]  # fmt: skip
    assert [one["failure"] and one["failure"]["code"] for one in items] == [
        None, "wrong_state", "not_found", "wrong_state",
    ]  # fmt: skip
    assert row_of(platform_on, refused).state == "queued"
    with platform_on.database.reading() as session:
        lines = session.execute(select(AuditEntry.act, AuditEntry.subject_id, AuditEntry.reason)).all()
    assert [tuple(line) for line in lines if line.act.startswith("job.")] == [("job.retry", refused, WHY)]


def test_jobs_of_one_run_are_one_act(api: httpx.Client, platform: Platform, administrator: Person) -> None:
    root_id = run(platform, person(platform, "curator"), "ingest.speak", "labeler.speak")
    children = ids(ask(api, administrator, "/jobs", root_id=root_id))
    items = acts(api, administrator, "cancel", *children, root_id)
    assert {(one["root_id"], one["state"]) for one in items} == {(root_id, "cancelled")}
    assert [one["failure"] for one in items] == [None] * 3


def test_an_owner_is_told_why_an_administrator_cancelled_and_not_of_what_they_cancelled(
    api: httpx.Client, platform: Platform, administrator: Person
) -> None:
    ada = person(platform, "curator")
    forest = sequence(api, ada)
    theirs, own = (run(platform, ada, "ingest.speak", sequence_id=forest["id"]) for _ in range(2))
    acts(api, administrator, "cancel", theirs)
    assert api.post(f"/api/v1/jobs/{own}/cancel", headers=ada.headers).status_code == 202
    with platform.database.reading() as session:
        (told,) = session.scalars(select(NotificationEvent).where(NotificationEvent.kind == RUN_FAILED)).all()
        message = message_of(session, told)
    assert (told.subject_id, told.user_id) == (theirs, ada.user_id)
    assert message is not None
    assert message.text == f"Processing of “forest” was cancelled by an administrator: {WHY}"


@pytest.mark.parametrize(("body", "why"), [({"reason": WHY}, WHY), (None, "no reason was given")])
def test_an_owner_is_told_once_of_a_run_that_an_administrator_cancels_on_the_sequences_page(
    api: httpx.Client, platform: Platform, administrator: Person, body: dict[str, str] | None, why: str
) -> None:
    ada = person(platform, "curator")
    theirs = run(platform, ada, "ingest.speak", sequence_id=sequence(api, ada)["id"])
    with platform.database.transaction() as session:
        for row in session.scalars(select(Job).where(Job.root_id == theirs)):
            row.state = "running"  # so that it can be terminated too
    cancelled = api.post(f"/api/v1/jobs/{theirs}/cancel", json=body, headers=administrator.headers)
    assert (cancelled.status_code, cancelled.json()["cancel_reason"]) == (202, why)
    acts(api, administrator, "terminate", theirs)
    with platform.database.reading() as session:
        (told,) = session.scalars(select(NotificationEvent).where(NotificationEvent.kind == RUN_FAILED)).all()
    assert (told.subject_id, told.user_id, told.facts["failure"]) == (theirs, ada.user_id, why)


@pytest.mark.parametrize(
    "change",
    [
        {"job_ids": []}, {"job_ids": [NOBODY] * 201}, {"job_ids": ["x"]}, {"act": "revive"}, {"reason": " "},
        {"reason": "a\u001b[2J"}, {"more": 1},
    ],
)  # fmt: skip
def test_what_cannot_be_meant_is_refused_whole(
    api: httpx.Client, platform: Platform, administrator: Person, change: dict[str, Any]
) -> None:
    job_id = job(platform, administrator, "ingest.speak")
    body = {"act": "cancel", "job_ids": [job_id], "reason": WHY} | change
    assert api.post(f"{ADMIN}/jobs/acts", json=body, headers=administrator.headers).status_code == 422
    assert row_of(platform, job_id).state == "queued"


def test_jobs_are_counted_by_state_under_the_filters(api_on: httpx.Client, platform_on: Platform) -> None:
    ada, bob = person(platform_on, "curator"), person(platform_on, "curator")
    admin = person(platform_on, "administrator")
    dead = job(platform_on, ada, "ingest.refuse")
    job(platform_on, bob, "ingest.refuse")
    run_all(platform_on)
    exhaust(platform_on, dead)
    run(platform_on, ada, "ingest.speak", "labeler.speak")
    nothing = {"queued": 0, "running": 0, "succeeded": 0, "failed": 0, "cancelled": 0, "dead": 0}
    assert ask(api_on, admin, "/jobs/counts") == nothing | {"queued": 1, "failed": 2, "dead": 1}
    assert ask(api_on, admin, "/jobs/counts", owner=bob.name) == nothing | {"failed": 1}
    assert ask(api_on, admin, "/jobs/counts", queue="labeler", state="failed") == nothing | {"queued": 1}
    assert ask(api_on, admin, "/jobs/counts", kind="ingest.refuse") == nothing | {"failed": 2, "dead": 1}
    assert ids(ask(api_on, admin, "/jobs", dead=True)) == [dead]
    assert ids(ask(api_on, admin, "/jobs", dead=True, owner=bob.name)) == []


def test_a_job_is_found_by_how_its_id_begins_or_ends(api_on: httpx.Client, platform_on: Platform) -> None:
    ada, admin = person(platform_on, "curator"), person(platform_on, "administrator")
    root_id = run(platform_on, ada, "ingest.speak")
    (child,) = ids(ask(api_on, admin, "/jobs", root_id=root_id))
    for whole in (root_id, child):
        for part in (whole[-8:], whole[:18], whole):
            assert whole in ids(ask(api_on, admin, "/jobs", id_part=part))
    assert ids(ask(api_on, admin, "/jobs", id_part="f" * 12)) == []
    for odd in ("abc", "%%%%", "ABCD", "a" * 33):
        assert api_on.get(f"{ADMIN}/jobs", params={"id_part": odd}, headers=admin.headers).status_code == 422


def test_the_list_names_owner_and_sequence_and_says_when_a_run_will_end(
    api: httpx.Client, platform: Platform, administrator: Person
) -> None:
    ada = person(platform, "curator")
    forest = sequence(api, ada)
    run(platform, ada, "ingest.speak", "labeler.speak", sequence_id=forest["id"])
    assert run_next(platform, "ingest", HANDLERS)
    (item,) = ask(api, administrator, "/jobs")["items"]
    assert (item["owner"], item["sequence"], item["attempts_left"]) == (ada.name, "forest", 0)
    assert item["progress"]["eta_s"] > 0
    detail = ask(api, administrator, f"/jobs/{item['id']}")
    assert (detail["owner"], detail["sequence"]) == (ada.name, "forest")
    own = [api.get(f"/api/v1/jobs{path}", headers=ada.headers).json() for path in ("", f"/{item['id']}")]
    told = {one["progress"]["eta_s"] for one in (item, detail, own[0]["items"][0], own[1])}
    assert len(told) == 1, "one run, several estimates"
    assert {child["progress"]["eta_s"] for child in detail["children"]} == {None}
    assert item["title"] == "Labelling"


def test_a_queue_says_how_long_its_oldest_waits_and_what_it_achieved(
    api_on: httpx.Client, platform_on: Platform
) -> None:
    ada, admin = person(platform_on, "curator"), person(platform_on, "administrator")
    ended = [job(platform_on, ada, "ingest.speak") for _ in range(3)] + [job(platform_on, ada, "ingest.refuse")]
    run_all(platform_on)
    with platform_on.database.transaction() as session:
        ago = update(Job).where(Job.id == ended[0]).values(finished_ns=now_ns() - 20 * 60 * 10**9)
        session.execute(ago)
    waits = job(platform_on, ada, "ingest.speak")
    with platform_on.database.transaction() as session:
        session.execute(update(Job).where(Job.id == waits).values(created_ns=now_ns() - 90 * 10**9))
    ingest, labeler, _eval = ask(api_on, admin, "/queues")
    assert (ingest["ready"], ingest["succeeded_lately"], ingest["failed_lately"]) == (1, 2, 1)
    assert 89 < ingest["oldest_ready_s"] < 200
    assert (len(ingest["per_minute"]), sum(ingest["per_minute"])) == (30, 3)
    assert sum(ingest["per_minute"][8:12]) == 1
    assert (labeler["oldest_ready_s"], labeler["per_minute"]) == (None, [0] * 30)


def test_a_worker_is_shown_with_the_job_it_holds(api: httpx.Client, platform: Platform, administrator: Person) -> None:
    job_id = job(platform, administrator, "ingest.speak")
    WorkerHeartbeat(platform, ["ingest"]).tell()
    with platform.database.transaction() as session:
        claim(session, "ingest")
    (worker,) = ask(api, administrator, "/workers")["workers"]
    assert (worker["job_id"], worker["kind"], worker["attempt"]) == (job_id, "ingest.speak", 1)
    assert (worker["queues"], worker["is_silent"]) == (["ingest"], False)


def test_the_figures_of_the_dashboard_are_read_off_indexes_alone(platform: Platform) -> None:
    with platform.database.transaction() as session:
        fill(session, runs=40, workers=3)
    said: list[tuple[str, Any]] = []

    def note(_connection: Any, _cursor: Any, statement: str, parameters: Any, *_: Any) -> None:
        said.append((statement, parameters))

    event.listen(platform.database.engine, "before_cursor_execute", note)
    with platform.database.reading() as session:
        queue_items(session)
        job_counts(session, AdminFilters().of_any_state(select(Job)), AdminFilters().flat(select(Job)))
    event.remove(platform.database.engine, "before_cursor_execute", note)
    with platform.database.engine.connect() as connection:
        plans = [
            " ".join(row[-1] for row in connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {statement}", parameters))
            for statement, parameters in said
            if "FROM jobs" in statement
        ]
    assert ["SCAN jobs USING INDEX" in plan or plan == "SCAN jobs " for plan in plans] == [False] * 4
    assert "COVERING INDEX ix_jobs_finished" in plans[1]
    assert "COVERING INDEX ix_jobs_state" in plans[2]
