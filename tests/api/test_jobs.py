"""Jobs as their owner sees them, and as administrators find, count and steer them, one by one or many at once."""

import socket
from collections.abc import Mapping
from typing import Any

import httpx
import pytest
from sqlalchemy import event, select, update

from api.routes.admin.admin_jobs import AdminFilters
from api.views.admin import job_counts, queue_items
from benchmarks.dashboard.rows import fill
from services.domain.notifications.messages import message_of
from services.runtime.jobs.claims import claim
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.specs import Attempt, Handlers, JobSpec, Outcome
from services.runtime.jobs.worker_presence import WorkerHeartbeat
from services.runtime.notifications.events import RUN_FAILED
from services.runtime.orm import AuditEntry, Job, JobLine, NotificationEvent
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.settings import BrokerSettings
from stone.errors import StoneError
from testing.api.serving import Person, client_of, person
from testing.servers.fixtures import make_settings, opened
from testing.worlds.made import NOBODY, job, row_of, run, sequence

JOBS, ADMIN = "/api/v1/jobs", "/api/v1/admin"
WHY = {"reason": "worker-3 is being replaced"}


class CutBagError(StoneError):
    code = "cut_bag"

    def __init__(self) -> None:
        super().__init__("the bag is cut at byte 7")


def speak(attempt: Attempt) -> Outcome:
    for number in range(5):
        attempt.log(f"line {number}", number=number)
    attempt.progress("count", 3, 7)
    return Outcome({"said": 5})


def refuse(_attempt: Attempt) -> Outcome:
    raise CutBagError()


def fan_out(_attempt: Attempt) -> Outcome:
    return Outcome({}, then=(JobSpec("labeler.speak"), JobSpec("labeler.speak")))


HANDLERS: Handlers = {
    "ingest.speak": speak, "labeler.speak": speak, "ingest.refuse": refuse, "ingest.fan_out": fan_out,
}  # fmt: skip


def run_all(platform: Platform) -> None:
    while any(run_next(platform, queue, HANDLERS) for queue in ("ingest", "labeler")):
        pass


def shown(api: httpx.Client, caller: Person, path: str, **query: Any) -> Any:
    answer = api.get(path, params=query, headers=caller.headers)
    assert answer.status_code == 200, answer.text
    return answer.json()


def ids(page: Mapping[str, Any]) -> list[str]:
    return [item["id"] for item in page["items"]]


def test_a_run_says_how_far_its_stages_are(api: httpx.Client, platform: Platform) -> None:
    ada = person(platform, "curator")
    root_id = run(platform, ada, "ingest.fan_out")
    assert run_next(platform, "ingest", HANDLERS)
    assert run_next(platform, "labeler", HANDLERS)
    body = shown(api, ada, f"{JOBS}/{root_id}")
    assert (body["state"], body["queue"], body["failure"], body["finished_at"]) == ("running", "", None, None)
    assert body["progress"] | {"eta_s": 0} == {"stage": "", "done": 2, "total": 3, "rate_per_s": None, "eta_s": 0}
    assert body["progress"]["eta_s"] > 0
    assert [(stage["kind"], stage["done"], stage["total"]) for stage in body["stages"]] == [
        ("ingest.fan_out", 1, 1),
        ("labeler.speak", 1, 2),
    ]
    listed = shown(api, ada, JOBS)["items"][0]
    assert (listed["progress"]["done"], listed["progress"]["total"]) == (2, 3)
    run_all(platform)
    assert shown(api, ada, f"{JOBS}/{root_id}")["state"] == "succeeded"


def test_a_job_says_what_it_answered_and_a_failed_one_why(
    api: httpx.Client, platform: Platform, curator: Person
) -> None:
    spoke, refused = job(platform, curator, "ingest.speak"), job(platform, curator, "ingest.refuse")
    run_all(platform)
    good, bad = (shown(api, curator, f"{JOBS}/{job_id}") for job_id in (spoke, refused))
    assert (good["state"], good["result"], good["failure"]) == ("succeeded", {"said": 5}, None)
    assert bad["failure"] == {"code": "cut_bag", "sentence": "the bag is cut at byte 7"}
    assert [(one["number"], one["outcome"]) for one in bad["attempts"]] == [(1, "failed")]
    assert bad["attempts"][0]["failure"] == bad["failure"]
    assert good["created_at"] < good["started_at"] < good["finished_at"]


def test_a_log_is_read_on_from_where_it_was_left(api: httpx.Client, platform: Platform) -> None:
    ada = person(platform, "curator")
    job_id = job(platform, ada, "ingest.speak")
    path = f"{JOBS}/{job_id}/logs"
    assert shown(api, ada, path) == {"items": [], "next": None}
    run_all(platform)
    first = shown(api, ada, path, limit=2)
    rest = shown(api, ada, path, after=first["next"])
    end = shown(api, ada, path, after=rest["next"])
    assert [line["event"] for line in first["items"] + rest["items"]] == [f"line {number}" for number in range(5)]
    assert first["items"][1]["facts"] == {"number": 1}
    assert end == {"items": [], "next": rest["next"]}


def test_a_runs_log_is_that_of_all_its_jobs_by_the_clock(api_on: httpx.Client, platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    root_id = run(platform_on, ada, "ingest.speak", "labeler.speak")
    run(platform_on, ada, "ingest.speak")
    run_all(platform_on)
    lines: list[Any] = []
    after = None
    while body := shown(api_on, ada, f"{JOBS}/{root_id}/logs", limit=3, **({"after": after} if after else {})):
        lines, after = lines + body["items"], body["next"]
        if not body["items"]:
            break
    assert [line["event"] for line in lines] == [f"line {number}" for number in range(5)] * 2
    assert len({line["job_id"] for line in lines}) == 2


def test_what_a_running_run_said_just_now_is_held_back_until_it_has_settled(
    api: httpx.Client, platform: Platform, curator: Person
) -> None:
    root_id = run(platform, curator, "ingest.speak", "labeler.speak")
    assert run_next(platform, "ingest", HANDLERS)
    assert shown(api, curator, f"{JOBS}/{root_id}/logs")["items"] == []
    with platform.database.transaction() as session:
        for line in session.query(JobLine):
            line.logged_ns -= 3 * 10**9
    assert len(shown(api, curator, f"{JOBS}/{root_id}/logs")["items"]) == 5


def test_an_owner_stops_a_whole_run_by_any_of_its_jobs(api: httpx.Client, platform: Platform) -> None:
    ada = person(platform, "curator")
    root_id = run(platform, ada, "ingest.speak", "labeler.speak")
    child = shown(api, ada, JOBS, root_id=root_id)["items"][0]["id"]
    answer = api.post(f"{JOBS}/{child}/cancel", json={"reason": "wrong bag"}, headers=ada.headers)
    assert answer.status_code == 202, answer.text
    assert (answer.json()["id"], answer.json()["state"]) == (root_id, "cancelled")
    assert answer.json()["cancel_reason"] == "wrong bag"
    assert not run_next(platform, "ingest", HANDLERS)


def test_administrators_see_everybodys_jobs(api: httpx.Client, platform: Platform) -> None:
    root, ada, bob = (person(platform, role) for role in ("administrator", "curator", "curator"))
    hers, his = run(platform, ada, "ingest.speak", "labeler.speak"), job(platform, bob, "ingest.refuse")
    assert ids(shown(api, root, f"{ADMIN}/jobs")) == [his, hers]
    assert ids(shown(api, root, JOBS)) == [], "GET /jobs lists one's own"
    assert ids(shown(api, root, f"{ADMIN}/jobs", owner_id=bob.user_id)) == [his]
    assert ids(shown(api, root, f"{ADMIN}/jobs", kind="sequence.process")) == [hers]
    queued = shown(api, root, f"{ADMIN}/jobs", queue="ingest", state="queued")["items"]
    assert [item["kind"] for item in queued] == ["ingest.refuse", "ingest.speak"], "a queue's jobs, one by one"
    detail = shown(api, root, f"{ADMIN}/jobs/{hers}")
    assert (detail["children_total"], [child["kind"] for child in detail["children"]]) == (
        2, ["ingest.speak", "labeler.speak"],
    )  # fmt: skip
    assert shown(api, root, f"{ADMIN}/jobs/{hers}/logs") == {"items": [], "next": None}


def test_what_failed_is_retried_and_what_runs_is_stopped(api: httpx.Client, platform: Platform) -> None:
    root, ada = person(platform, "administrator"), person(platform, "curator")
    failed, queued = run(platform, ada, "ingest.refuse"), job(platform, ada, "labeler.speak")
    assert run_next(platform, "ingest", HANDLERS)

    def steered(job_id: str, act: str) -> tuple[int, str]:
        answer = api.post(f"{ADMIN}/jobs/{job_id}/{act}", json=WHY, headers=root.headers)
        return answer.status_code, answer.json().get("state", answer.json().get("code"))

    assert steered(failed, "cancel") == (409, "wrong_state")
    assert steered(queued, "retry") == (409, "wrong_state")
    assert steered(failed, "retry") == (202, "queued")
    assert steered(failed, "cancel") == (202, "cancelled")
    with platform.database.transaction() as session:
        assert claim(session, "labeler")
    assert steered(queued, "cancel") == (202, "running"), "softly: its worker stops it"
    assert steered(queued, "terminate") == (202, "cancelled")
    lines = shown(api, root, f"{ADMIN}/audit-log")["items"]
    acts = {(line["act"], line["subject_id"], line["reason"]) for line in lines}
    assert {("job.retry", failed, WHY["reason"]), ("job.terminate", queued, WHY["reason"])} <= acts


def test_a_queue_is_paused_drained_and_opened(
    api: httpx.Client, platform: Platform, bells: list[tuple[str, int]]
) -> None:
    root, ada = person(platform, "administrator"), person(platform, "curator")
    run(platform, ada, "ingest.speak", "ingest.speak")
    bells.clear()

    def switched(act: str) -> tuple[Any, ...]:
        answer = api.post(f"{ADMIN}/queues/ingest/{act}", json=WHY, headers=root.headers)
        assert answer.status_code == 200, answer.text
        return tuple(answer.json()[key] for key in ("name", "mode", "ready", "waiting", "running"))

    assert switched("pause") == ("ingest", "paused", 1, 1, 0)
    assert not run_next(platform, "ingest", HANDLERS)
    assert (switched("drain")[1], bells) == ("draining", [("ingest", 1)])
    assert run_next(platform, "ingest", HANDLERS)
    assert switched("resume") == ("ingest", "open", 1, 0, 0)
    modes = {queue["name"]: queue["mode"] for queue in shown(api, root, f"{ADMIN}/queues")["items"]}
    assert modes == {"ingest": "open", "labeler": "open", "eval": "open"}


def test_workers_are_told_by_the_database_when_the_broker_is_away(
    tmp_path: Any, settings: Any, bells: list[tuple[str, int]]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as closed:
        port = closed.getsockname()[1]
    away = make_settings(tmp_path, broker=BrokerSettings(url=f"redis://127.0.0.1:{port}/0"))
    platform = opened(away, bells)
    root, ada = person(platform, "administrator"), person(platform, "curator")
    job_id = job(platform, ada, "ingest.speak")
    with platform.database.transaction() as session:
        assert claim(session, "ingest")
    with client_of(platform, root) as api:
        workers = api.get(f"{ADMIN}/workers")
        assert workers.elapsed.total_seconds() < 10
        body = workers.json()
        assert body["is_broker_reachable"] is False
        assert [(one["job_id"], one["kind"], one["attempt"]) for one in body["running"]] == [
            (job_id, "ingest.speak", 1)
        ]
        assert body["running"][0]["worker"].startswith(socket.gethostname())
        assert [queue["wake_ups"] for queue in api.get(f"{ADMIN}/queues").json()["items"]] == [None, None, None]
    platform.database.close()


def test_bells_are_asked_of_a_real_broker(
    tmp_path: Any, settings: Any, bells: list[tuple[str, int]], redis_url: str
) -> None:
    platform = opened(make_settings(tmp_path, broker=BrokerSettings(url=redis_url)), bells)
    with client_of(platform, person(platform, "administrator")) as api:
        body = api.get(f"{ADMIN}/workers").json()
        assert body["is_broker_reachable"] is True
        assert [type(queue["wake_ups"]) for queue in api.get(f"{ADMIN}/queues").json()["items"]] == [int, int, int]
    platform.database.close()


FULL = "the disk was full"


def ask(api: httpx.Client, caller: Person, path: str, **query: Any) -> Any:
    answer = api.get(ADMIN + path, params=query, headers=caller.headers)
    assert answer.status_code == 200, answer.text
    return answer.json()


def acts(api: httpx.Client, caller: Person, act: str, *job_ids: str) -> list[dict[str, Any]]:
    body = {"act": act, "job_ids": list(job_ids), "reason": FULL}
    answer = api.post(f"{ADMIN}/jobs/acts", json=body, headers=caller.headers)
    assert answer.status_code == 200, answer.text
    items: list[dict[str, Any]] = answer.json()["items"]
    return items


def exhaust(platform: Platform, job_id: str) -> None:
    with platform.database.transaction() as session:
        session.execute(update(Job).where(Job.id == job_id).values(attempts_left=0))


def test_each_of_many_is_done_or_says_why_not(api: httpx.Client, platform: Platform) -> None:
    ada, admin = person(platform, "curator"), person(platform, "administrator")
    refused, spoke = job(platform, ada, "ingest.refuse"), job(platform, ada, "ingest.speak")
    run_all(platform)
    queued = job(platform, ada, "ingest.speak")
    items = acts(api, admin, "retry", refused, spoke, NOBODY, queued, refused)
    assert [(one["job_id"], one["state"]) for one in items] == [
        (refused, "queued"), (spoke, None), (NOBODY, None), (queued, None),
    ]  # fmt: skip
    assert [one["failure"] and one["failure"]["code"] for one in items] == [
        None, "wrong_state", "not_found", "wrong_state",
    ]  # fmt: skip
    assert row_of(platform, refused).state == "queued"
    with platform.database.reading() as session:
        lines = session.execute(select(AuditEntry.act, AuditEntry.subject_id, AuditEntry.reason)).all()
    assert [tuple(line) for line in lines if line.act.startswith("job.")] == [("job.retry", refused, FULL)]


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
    assert message.text == f"Processing of “forest” was cancelled by an administrator: {FULL}"


@pytest.mark.parametrize(("body", "why"), [({"reason": FULL}, FULL), (None, "no reason was given")])
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


def test_jobs_are_counted_by_state_under_the_filters(api: httpx.Client, platform: Platform) -> None:
    ada, bob = person(platform, "curator"), person(platform, "curator")
    admin = person(platform, "administrator")
    dead = job(platform, ada, "ingest.refuse")
    job(platform, bob, "ingest.refuse")
    run_all(platform)
    exhaust(platform, dead)
    run(platform, ada, "ingest.speak", "labeler.speak")
    nothing = {"queued": 0, "running": 0, "succeeded": 0, "failed": 0, "cancelled": 0, "dead": 0}
    assert ask(api, admin, "/jobs/counts") == nothing | {"queued": 1, "failed": 2, "dead": 1}
    assert ask(api, admin, "/jobs/counts", owner=bob.name) == nothing | {"failed": 1}
    assert ask(api, admin, "/jobs/counts", queue="labeler", state="failed") == nothing | {"queued": 1}
    assert ask(api, admin, "/jobs/counts", kind="ingest.refuse") == nothing | {"failed": 2, "dead": 1}
    assert ids(ask(api, admin, "/jobs", dead=True)) == [dead]
    assert ids(ask(api, admin, "/jobs", dead=True, owner=bob.name)) == []


def test_a_job_is_found_by_how_its_id_begins_or_ends(api: httpx.Client, platform: Platform) -> None:
    ada, admin = person(platform, "curator"), person(platform, "administrator")
    root_id = run(platform, ada, "ingest.speak")
    (child,) = ids(ask(api, admin, "/jobs", root_id=root_id))
    for whole in (root_id, child):
        for part in (whole[-8:], whole[:18], whole):
            assert whole in ids(ask(api, admin, "/jobs", id_part=part))
    assert ids(ask(api, admin, "/jobs", id_part="f" * 12)) == []


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
    assert item["title"] == "Label the sequence"


def test_a_queue_says_how_long_its_oldest_waits_and_what_it_achieved(api: httpx.Client, platform: Platform) -> None:
    ada, admin = person(platform, "curator"), person(platform, "administrator")
    ended = [job(platform, ada, "ingest.speak") for _ in range(3)] + [job(platform, ada, "ingest.refuse")]
    run_all(platform)
    with platform.database.transaction() as session:
        ago = update(Job).where(Job.id == ended[0]).values(finished_ns=now_ns() - 20 * 60 * 10**9)
        session.execute(ago)
    waits = job(platform, ada, "ingest.speak")
    with platform.database.transaction() as session:
        session.execute(update(Job).where(Job.id == waits).values(created_ns=now_ns() - 90 * 10**9))
    ingest, labeler, _eval = ask(api, admin, "/queues")["items"]
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
