"""Jobs as their owner sees them, and as administrators steer them."""

import socket
from collections.abc import Mapping
from typing import Any

import httpx
import pytest

from services.runtime.jobs.claims import claim
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.specs import Attempt, Handlers, JobSpec, Outcome
from services.runtime.orm import JobLine
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


OWN = [("GET", ""), ("GET", f"/{NOBODY}"), ("GET", f"/{NOBODY}/logs"), ("POST", f"/{NOBODY}/cancel")]
STEERING = [
    ("GET", "/jobs"), ("GET", f"/jobs/{NOBODY}"), ("GET", f"/jobs/{NOBODY}/logs"), ("POST", f"/jobs/{NOBODY}/retry"),
    ("POST", f"/jobs/{NOBODY}/cancel"), ("POST", f"/jobs/{NOBODY}/terminate"), ("GET", "/queues"), ("GET", "/workers"),
    ("POST", "/queues/ingest/pause"), ("POST", "/queues/ingest/drain"), ("POST", "/queues/ingest/resume"),
]  # fmt: skip


def test_nobody_without_a_token_sees_or_steers_a_job(api: httpx.Client) -> None:
    for method, path in [(method, JOBS + path) for method, path in OWN] + [(m, ADMIN + p) for m, p in STEERING]:
        assert api.request(method, path, json=WHY if method == "POST" else None).status_code == 401, path


def test_only_administrators_steer(api: httpx.Client, platform: Platform, curator: Person) -> None:
    root_id = run(platform, curator, "ingest.speak")
    weak = person(platform, "administrator", scopes=["read", "upload"])
    for caller in (curator, weak, person(platform, "participant")):
        for method, path in STEERING:
            own = path.replace(NOBODY, root_id)
            answer = api.request(method, ADMIN + own, json=WHY if method == "POST" else None, headers=caller.headers)
            assert answer.status_code == 403, path
    assert row_of(platform, root_id).state == "queued"


def test_a_job_of_somebody_else_does_not_exist(api_on: httpx.Client, platform_on: Platform) -> None:
    ada, eve = person(platform_on, "curator"), person(platform_on, "curator")
    root_id = run(platform_on, ada, "ingest.speak")
    for method, path in OWN[1:]:
        answer = api_on.request(method, JOBS + path.replace(NOBODY, root_id), headers=eve.headers)
        assert (answer.status_code, answer.json()["code"]) == (404, "not_found")
    assert shown(api_on, eve, JOBS)["items"] == []
    assert shown(api_on, eve, JOBS, root_id=root_id)["items"] == []
    assert row_of(platform_on, root_id).state == "queued"


@pytest.mark.parametrize(
    "query", [{"state": "lost"}, {"kind": "a\u0000"}, {"sequence_id": "x"}, {"root_id": ""}, {"cursor": "e30"}]
)
def test_a_list_that_cannot_be_meant_is_refused(api: httpx.Client, curator: Person, query: dict[str, str]) -> None:
    assert api.get(JOBS, params=query, headers=curator.headers).status_code == 422


@pytest.mark.parametrize("after", ["", "x", "1.2.3.4", f"1.{NOBODY}.1", f"-1.{NOBODY}.1.1", f"{10**19}.{NOBODY}.1.1"])
def test_a_place_in_a_log_that_was_never_given_is_refused(
    api: httpx.Client, platform: Platform, curator: Person, after: str
) -> None:
    path = f"{JOBS}/{job(platform, curator, 'ingest.speak')}/logs"
    answer = api.get(path, params={"after": after}, headers=curator.headers)
    assert (answer.status_code, answer.json()["code"]) == (422, "bad_cursor")


def test_what_has_ended_is_not_cancelled(api: httpx.Client, platform: Platform, curator: Person) -> None:
    root_id = run(platform, curator, "ingest.speak")
    run_all(platform)
    answer = api.post(f"{JOBS}/{root_id}/cancel", headers=curator.headers)
    assert (answer.status_code, answer.json()["code"]) == (409, "wrong_state")


@pytest.mark.parametrize(
    "body", [None, {}, {"reason": ""}, {"reason": "  "}, {"reason": "a\u001b[2J"}, {"reason": "x" * 501}]
)
def test_an_administrator_says_why(
    api: httpx.Client, platform: Platform, administrator: Person, curator: Person, body: object
) -> None:
    root_id = run(platform, curator, "ingest.speak")
    for path in (f"/jobs/{root_id}/cancel", f"/jobs/{root_id}/terminate", "/queues/ingest/pause"):
        assert api.post(ADMIN + path, json=body, headers=administrator.headers).status_code == 422, path
    assert row_of(platform, root_id).state == "queued"
    assert shown(api, administrator, f"{ADMIN}/queues")[0]["mode"] == "open"


def test_there_are_three_queues_and_three_switches(api: httpx.Client, administrator: Person) -> None:
    assert api.post(f"{ADMIN}/queues/other/pause", json=WHY, headers=administrator.headers).status_code == 404
    assert api.post(f"{ADMIN}/queues/eval/purge", json=WHY, headers=administrator.headers).status_code == 422
    assert api.post(f"{ADMIN}/jobs/{NOBODY}/revive", json=WHY, headers=administrator.headers).status_code == 422


def test_an_owner_sees_their_runs_newest_first(api_on: httpx.Client, platform_on: Platform) -> None:
    ada, bob = person(platform_on, "curator"), person(platform_on, "curator")
    forest = sequence(api_on, ada)
    first = run(platform_on, ada, "ingest.speak", "labeler.speak", sequence_id=forest["id"])
    second = job(platform_on, ada, "ingest.refuse")
    run(platform_on, bob, "ingest.speak")
    assert ids(shown(api_on, ada, JOBS)) == [second, first]
    assert ids(shown(api_on, ada, JOBS, sequence_id=forest["id"])) == [first]
    assert ids(shown(api_on, ada, JOBS, kind="ingest.refuse")) == [second]
    assert ids(shown(api_on, ada, JOBS, state="failed")) == []
    run_all(platform_on)
    assert ids(shown(api_on, ada, JOBS, state="failed")) == [second]
    children = shown(api_on, ada, JOBS, root_id=first)["items"]
    assert [child["kind"] for child in children] == ["labeler.speak", "ingest.speak"]
    assert {child["root_id"] for child in children} == {first}
    page = shown(api_on, ada, JOBS, limit=1)
    assert ids(page) + ids(shown(api_on, ada, JOBS, limit=1, cursor=page["next"])) == [second, first]


def test_a_run_says_how_far_its_stages_are(api_on: httpx.Client, platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    root_id = run(platform_on, ada, "ingest.fan_out")
    assert run_next(platform_on, "ingest", HANDLERS)
    assert run_next(platform_on, "labeler", HANDLERS)
    body = shown(api_on, ada, f"{JOBS}/{root_id}")
    assert (body["state"], body["queue"], body["failure"], body["finished_at"]) == ("running", "", None, None)
    assert body["progress"] | {"eta_s": 0} == {"stage": "", "done": 2, "total": 3, "rate_per_s": None, "eta_s": 0}
    assert body["progress"]["eta_s"] > 0
    assert [(stage["kind"], stage["done"], stage["total"]) for stage in body["stages"]] == [
        ("ingest.fan_out", 1, 1),
        ("labeler.speak", 1, 2),
    ]
    listed = shown(api_on, ada, JOBS)["items"][0]
    assert (listed["progress"]["done"], listed["progress"]["total"]) == (2, 3)
    run_all(platform_on)
    assert shown(api_on, ada, f"{JOBS}/{root_id}")["state"] == "succeeded"


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


def test_a_log_is_read_on_from_where_it_was_left(api_on: httpx.Client, platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    job_id = job(platform_on, ada, "ingest.speak")
    path = f"{JOBS}/{job_id}/logs"
    assert shown(api_on, ada, path) == {"items": [], "next": None}
    run_all(platform_on)
    first = shown(api_on, ada, path, limit=2)
    rest = shown(api_on, ada, path, after=first["next"])
    end = shown(api_on, ada, path, after=rest["next"])
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


def test_an_owner_stops_a_whole_run_by_any_of_its_jobs(api_on: httpx.Client, platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    root_id = run(platform_on, ada, "ingest.speak", "labeler.speak")
    child = shown(api_on, ada, JOBS, root_id=root_id)["items"][0]["id"]
    answer = api_on.post(f"{JOBS}/{child}/cancel", json={"reason": "wrong bag"}, headers=ada.headers)
    assert answer.status_code == 202, answer.text
    assert (answer.json()["id"], answer.json()["state"]) == (root_id, "cancelled")
    assert answer.json()["cancel_reason"] == "wrong bag"
    assert not run_next(platform_on, "ingest", HANDLERS)


def test_administrators_see_everybodys_jobs(api_on: httpx.Client, platform_on: Platform) -> None:
    root, ada, bob = (person(platform_on, role) for role in ("administrator", "curator", "curator"))
    hers, his = run(platform_on, ada, "ingest.speak", "labeler.speak"), job(platform_on, bob, "ingest.refuse")
    assert ids(shown(api_on, root, f"{ADMIN}/jobs")) == [his, hers]
    assert ids(shown(api_on, root, JOBS)) == [], "GET /jobs lists one's own"
    assert ids(shown(api_on, root, f"{ADMIN}/jobs", owner_id=bob.user_id)) == [his]
    assert ids(shown(api_on, root, f"{ADMIN}/jobs", kind="sequence.process")) == [hers]
    queued = shown(api_on, root, f"{ADMIN}/jobs", queue="ingest", state="queued")["items"]
    assert [item["kind"] for item in queued] == ["ingest.refuse", "ingest.speak"], "a queue's jobs, one by one"
    detail = shown(api_on, root, f"{ADMIN}/jobs/{hers}")
    assert (detail["children_total"], [child["kind"] for child in detail["children"]]) == (
        2, ["ingest.speak", "labeler.speak"],
    )  # fmt: skip
    assert shown(api_on, root, f"{ADMIN}/jobs/{hers}/logs") == {"items": [], "next": None}


def test_what_failed_is_retried_and_what_runs_is_stopped(api_on: httpx.Client, platform_on: Platform) -> None:
    root, ada = person(platform_on, "administrator"), person(platform_on, "curator")
    failed, queued = run(platform_on, ada, "ingest.refuse"), job(platform_on, ada, "labeler.speak")
    assert run_next(platform_on, "ingest", HANDLERS)

    def steered(job_id: str, act: str) -> tuple[int, str]:
        answer = api_on.post(f"{ADMIN}/jobs/{job_id}/{act}", json=WHY, headers=root.headers)
        return answer.status_code, answer.json().get("state", answer.json().get("code"))

    assert steered(failed, "cancel") == (409, "wrong_state")
    assert steered(queued, "retry") == (409, "wrong_state")
    assert steered(failed, "retry") == (202, "queued")
    assert steered(failed, "cancel") == (202, "cancelled")
    with platform_on.database.transaction() as session:
        assert claim(session, "labeler")
    assert steered(queued, "cancel") == (202, "running"), "softly: its worker stops it"
    assert steered(queued, "terminate") == (202, "cancelled")
    lines = shown(api_on, root, f"{ADMIN}/audit-log")["items"]
    acts = {(line["act"], line["subject_id"], line["reason"]) for line in lines}
    assert {("job.retry", failed, WHY["reason"]), ("job.terminate", queued, WHY["reason"])} <= acts


def test_a_queue_is_paused_drained_and_opened(
    api_on: httpx.Client, platform_on: Platform, bells: list[tuple[str, int]]
) -> None:
    root, ada = person(platform_on, "administrator"), person(platform_on, "curator")
    run(platform_on, ada, "ingest.speak", "ingest.speak")
    bells.clear()

    def switched(act: str) -> tuple[Any, ...]:
        answer = api_on.post(f"{ADMIN}/queues/ingest/{act}", json=WHY, headers=root.headers)
        assert answer.status_code == 200, answer.text
        return tuple(answer.json()[key] for key in ("name", "mode", "ready", "waiting", "running"))

    assert switched("pause") == ("ingest", "paused", 1, 1, 0)
    assert not run_next(platform_on, "ingest", HANDLERS)
    assert (switched("drain")[1], bells) == ("draining", [("ingest", 1)])
    assert run_next(platform_on, "ingest", HANDLERS)
    assert switched("resume") == ("ingest", "open", 1, 0, 0)
    modes = {queue["name"]: queue["mode"] for queue in shown(api_on, root, f"{ADMIN}/queues")}
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
        assert [queue["bells"] for queue in api.get(f"{ADMIN}/queues").json()] == [None, None, None]
    platform.database.close()


def test_bells_are_asked_of_a_real_broker(
    tmp_path: Any, settings: Any, bells: list[tuple[str, int]], redis_url: str
) -> None:
    platform = opened(make_settings(tmp_path, broker=BrokerSettings(url=redis_url)), bells)
    with client_of(platform, person(platform, "administrator")) as api:
        body = api.get(f"{ADMIN}/workers").json()
        assert body["is_broker_reachable"] is True
        assert [type(queue["bells"]) for queue in api.get(f"{ADMIN}/queues").json()] == [int, int, int]
    platform.database.close()
