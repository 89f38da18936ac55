"""Sequences: who may make, see, change and delete them, and what comes of doing so twice or at once."""

import threading
from collections.abc import Mapping
from typing import Any

import httpx
import pytest

from services.runtime.orm import LabelSet, Recording, SequenceRow
from services.runtime.platform import Platform
from testing.api.serving import Person, client_of, person
from testing.worlds.made import NOBODY, labels, row_of, run, sequence, upload

URL = "/api/v1/sequences"
FACTS = {"environment": "mountain", "illumination": "day", "region": "Gyeonggi", "platform": "warthog-1"}


def code_of(answer: httpx.Response) -> str:
    assert answer.headers["content-type"] == "application/problem+json", answer.text
    return str(answer.json()["code"])


@pytest.fixture
def forest(api: httpx.Client, curator: Person) -> dict[str, Any]:
    return sequence(api, curator, "forest", **FACTS)


@pytest.fixture
def other(platform: Platform) -> Person:
    return person(platform, "curator")


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("POST", ""), ("GET", f"/{NOBODY}"), ("PATCH", f"/{NOBODY}"), ("DELETE", f"/{NOBODY}"),
        ("PUT", f"/{NOBODY}/calibration"),
    ],
)  # fmt: skip
def test_nobody_without_a_token_gets_anything(api: httpx.Client, method: str, path: str) -> None:
    answer = api.request(method, URL + path, json={})
    assert (answer.status_code, code_of(answer)) == (401, "unauthenticated")


def test_a_visitor_is_shown_what_is_public_and_asked_to_sign_in_for_the_rest(
    api: httpx.Client, curator: Person, other: Person
) -> None:
    made = [api.post(URL, json={"name": name}, headers=curator.headers).json() for name in ("open", "closed")]
    shown = api.patch(
        f"{URL}/{made[0]['id']}", json={"is_public": True}, headers={**curator.headers, "If-Match": '"1"'}
    )
    assert shown.json()["is_public"] is True
    for looking in ({}, other.headers):
        assert [item["name"] for item in api.get(URL, headers=looking).json()["items"]] == ["open"]
        assert api.get(f"{URL}/{made[0]['id']}", headers=looking).status_code == 200
    assert api.get(f"{URL}/{made[1]['id']}").status_code == 401
    assert api.get(f"{URL}/{made[1]['id']}", headers=other.headers).status_code == 404
    change = {"json": {"region": "x"}, "headers": {**other.headers, "If-Match": '"2"'}}
    assert api.patch(f"{URL}/{made[0]['id']}", **change).status_code == 404


def test_a_participant_may_look_but_not_make(api: httpx.Client, participant: Person) -> None:
    assert api.post(URL, json={"name": "a"}, headers=participant.headers).status_code == 403
    assert api.get(URL, headers=participant.headers).json()["items"] == []


def test_a_token_that_only_reads_makes_nothing(api: httpx.Client, platform: Platform) -> None:
    reader = person(platform, "curator", scopes=["read"])
    assert api.post(URL, json={"name": "a"}, headers=reader.headers).status_code == 403


@pytest.mark.parametrize(("method", "path"), [("GET", ""), ("PATCH", ""), ("DELETE", ""), ("PUT", "/calibration")])
def test_a_sequence_of_somebody_else_does_not_exist(
    api: httpx.Client, forest: Mapping[str, Any], other: Person, method: str, path: str
) -> None:
    body = {"calibration_id": NOBODY} if method == "PUT" else {}
    theirs = api.request(method, f"{URL}/{forest['id']}{path}", json=body, headers=other.headers)
    none = api.request(method, f"{URL}/{NOBODY}{path}", json=body, headers=other.headers)
    assert (theirs.status_code, code_of(theirs)) == (404, "not_found")
    assert none.json()["detail"] == theirs.json()["detail"].replace(forest["id"], NOBODY)
    assert api.get(URL, headers=other.headers, params={"owner_id": forest["owner_id"]}).json()["items"] == []


@pytest.mark.parametrize(
    "body",
    [
        {}, {"name": ""}, {"name": "../etc"}, {"name": "a b"}, {"name": ".hidden"}, {"name": "a\n"}, {"name": "é"},
        {"name": "a" * 101}, {"name": 7}, {"name": None}, {"name": "a", "environment": "x" * 65},
        {"name": "a", "region": "a\u0000b"}, {"name": "a", "owner_id": NOBODY}, {"name": "a", "revision": 9}, [], None,
    ],
)  # fmt: skip
def test_what_is_no_sequence_is_refused(api: httpx.Client, curator: Person, body: object) -> None:
    answer = api.post(URL, json=body, headers=curator.headers)
    assert (answer.status_code, code_of(answer)) == (422, "invalid_request")
    assert api.get(URL, headers=curator.headers).json()["items"] == []


@pytest.mark.parametrize(
    ("said", "code", "allowed"),
    [
        ({"environment": "forest"}, "unknown_environment", "farmland, mountain, lake, construction"),
        ({"illumination": "Day"}, "unknown_illumination", "day, sunny, overcast, dawn, dusk, night, moonlit, floodlit"),
        ({"region": "Gyeong gi"}, "bad_region", "letters, digits, dots, dashes"),
    ],
)
@pytest.mark.parametrize("method", ["POST", "PATCH"])
def test_a_word_that_is_not_the_datasets_is_refused_with_those_that_are(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any], method: str, said: dict[str, str], code: str,
    allowed: str,
) -> None:  # fmt: skip
    path = URL if method == "POST" else f"{URL}/{forest['id']}"
    headers = {**curator.headers, "If-Match": "*"}
    answer = api.request(method, path, json={"name": "other", **said}, headers=headers)
    (error,) = answer.json()["errors"]
    assert (answer.status_code, error["code"]) == (422, code)
    assert error["where"] == f"body.{next(iter(said))}"
    assert allowed in error["expected"]


def test_what_was_said_may_be_taken_back(api: httpx.Client, curator: Person, forest: Mapping[str, Any]) -> None:
    silent = dict.fromkeys(("environment", "illumination", "region"), "")
    headers = {**curator.headers, "If-Match": "*"}
    answer = api.patch(f"{URL}/{forest['id']}", json=silent, headers=headers)
    assert {key: answer.json()[key] for key in silent} == silent


@pytest.mark.parametrize(
    "query", [{"cursor": "!"}, {"limit": 0}, {"limit": 201}, {"name": "a\u0000"}, {"owner_id": "me"}, {"region": "\n"}]
)
def test_a_list_that_cannot_be_meant_is_refused(api: httpx.Client, curator: Person, query: dict[str, Any]) -> None:
    assert api.get(URL, params=query, headers=curator.headers).status_code == 422


def test_a_name_is_an_owners_own_once(api_on: httpx.Client, platform_on: Platform) -> None:
    ada, bob = person(platform_on, "curator"), person(platform_on, "curator")
    sequence(api_on, ada, "forest")
    sequence(api_on, bob, "forest")
    again = api_on.post(URL, json={"name": "forest"}, headers=ada.headers)
    assert (again.status_code, code_of(again)) == (409, "name_taken")


def test_of_two_that_take_a_name_at_once_one_gets_it(platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    with client_of(platform_on, ada) as client:
        answers: list[int] = []
        gate = threading.Barrier(4)

        def take() -> None:
            gate.wait()
            answers.append(httpx.post(f"{client.base_url}{URL}", json={"name": "x"}, headers=ada.headers).status_code)

        threads = [threading.Thread(target=take) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert sorted(answers) == [201, 409, 409, 409]
        assert len(client.get(URL).json()["items"]) == 1


@pytest.mark.parametrize("method", ["PATCH", "DELETE"])
def test_a_change_says_which_state_it_means(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any], method: str
) -> None:
    path = f"{URL}/{forest['id']}"
    missing = api.request(method, path, json={}, headers=curator.headers)
    stale = api.request(method, path, json={}, headers=curator.headers | {"If-Match": '"99"'})
    assert (missing.status_code, code_of(missing)) == (428, "precondition_required")
    assert (stale.status_code, code_of(stale)) == (412, "precondition_failed")
    assert api.get(path, headers=curator.headers).json() == forest


def test_who_changes_what_they_have_not_read_is_told_so(api_on: httpx.Client, platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    made = sequence(api_on, ada)
    match = ada.headers | {"If-Match": f'"{made["revision"]}"'}
    first = api_on.patch(f"{URL}/{made['id']}", json={"region": "A"}, headers=match)
    second = api_on.patch(f"{URL}/{made['id']}", json={"region": "B"}, headers=match)
    assert (first.status_code, second.status_code) == (200, 412)
    assert first.headers["etag"] == '"2"'
    assert api_on.get(f"{URL}/{made['id']}", headers=ada.headers).json()["region"] == "A"


def test_a_pinned_calibration_must_be_ones_own(api: httpx.Client, curator: Person, forest: Mapping[str, Any]) -> None:
    path = f"{URL}/{forest['id']}/calibration"
    assert api.put(path, json={"calibration_id": NOBODY}, headers=curator.headers).status_code == 404
    assert api.put(path, json={"calibration_id": "x"}, headers=curator.headers).status_code == 422
    stale = curator.headers | {"If-Match": '"99"'}
    assert api.put(path, json={"calibration_id": NOBODY}, headers=stale).status_code == 412


def test_a_sequence_with_labels_keeps_its_name(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any]
) -> None:
    labels(platform, forest)
    match = curator.headers | {"If-Match": "*"}
    renamed = api.patch(f"{URL}/{forest['id']}", json={"name": "wood"}, headers=match)
    assert (renamed.status_code, code_of(renamed)) == (409, "conflict")
    assert api.patch(f"{URL}/{forest['id']}", json={"region": "X"}, headers=match).json()["region"] == "X"


def test_a_sequence_is_made_shown_and_listed(api: httpx.Client, curator: Person, administrator: Person) -> None:
    answer = api.post(URL, json={"name": "forest", **FACTS}, headers=curator.headers)
    made = answer.json()
    assert answer.status_code == 201
    assert answer.headers["location"] == f"{URL}/{made['id']}"
    assert answer.headers["etag"] == '"1"'
    assert {key: made[key] for key in FACTS} == FACTS
    assert (made["owner_id"], made["recordings"], made["job"], made["labels"]) == (curator.user_id, 0, None, None)
    assert made["created_at"].endswith("Z")
    assert api.get(answer.headers["location"], headers=curator.headers).json() == made
    assert [item["id"] for item in api.get(URL, headers=administrator.headers).json()["items"]] == [made["id"]]


def test_a_name_may_have_a_hundred_characters(api_on: httpx.Client, platform_on: Platform) -> None:
    made = sequence(api_on, person(platform_on, "curator"), "a" * 100)
    assert made["name"] == "a" * 100


def test_lists_are_filtered_and_paged_newest_first(api_on: httpx.Client, platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    names = ["wood-1", "wood-2", "Wood-3", "hill_1", "hill-1"]
    for name in names:
        sequence(api_on, ada, name, environment="mountain" if name[0] == "h" else "lake", region="R-1")

    def listed(**query: Any) -> list[str]:
        answer = api_on.get(URL, params=query, headers=ada.headers)
        assert answer.status_code == 200, answer.text
        return [item["name"] for item in answer.json()["items"]]

    assert listed() == names[::-1]
    assert listed(name="wood") == ["wood-2", "wood-1"], "a prefix is taken to the letter"
    assert listed(name="hill_") == ["hill_1"], "nor is it a pattern"
    assert listed(name="%") == []
    assert listed(environment="mountain") == names[3:][::-1]
    assert listed(environment="mountain", name="hill-") == ["hill-1"]
    assert listed(region="R-1", limit=1) == names[-1:]
    seen, cursor = [], None
    while True:
        body = api_on.get(
            URL, params={"limit": 2, **({"cursor": cursor} if cursor else {})}, headers=ada.headers
        ).json()
        seen += [item["name"] for item in body["items"]]
        cursor = body["next"]
        if cursor is None:
            break
    assert seen == names[::-1]


def test_a_list_shows_the_newest_run_and_labels_of_each(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any]
) -> None:
    labels(platform, forest, frames=2)
    newest = labels(platform, forest, frames=5, seed=b"n")
    run_id = run(platform, curator, "ingest.ok", sequence_id=forest["id"])
    upload_id = upload(platform, curator)
    sequence(api, curator, "empty")
    api.post(f"{URL}/{forest['id']}/recordings", json={"upload_id": upload_id}, headers=curator.headers)
    empty, shown = api.get(URL, headers=curator.headers).json()["items"]
    assert (empty["labels"], empty["job"], empty["recordings"]) == (None, None, 0)
    assert (shown["labels"]["id"], shown["labels"]["frames"], shown["recordings"]) == (newest.id, 5, 1)
    assert shown["labels"]["code_version"] == "1"
    assert shown["job"]["kind"] == "ingest.register", "the newest"
    assert shown["job"]["id"] > run_id
    detail = api.get(f"{URL}/{forest['id']}", headers=curator.headers).json()
    names = ["bev.png", "frames.parquet", "mesh.ply", "report.json", "sequence.npz"]
    assert [file["name"] for file in detail["artefacts"]] == names


def test_a_deleted_sequence_is_gone_with_all_that_hangs_on_it(api_on: httpx.Client, platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    made = sequence(api_on, ada)
    labels(platform_on, made)
    upload_id = upload(platform_on, ada)
    added = api_on.post(f"{URL}/{made['id']}/recordings", json={"upload_id": upload_id}, headers=ada.headers).json()
    run_id = run(platform_on, ada, "ingest.ok", "labeler.ok", sequence_id=made["id"])
    gone = api_on.delete(f"{URL}/{made['id']}", headers=ada.headers | {"If-Match": "*"})
    assert (gone.status_code, gone.content) == (204, b"")
    for path in ("", "/recordings", "/report", "/frames", "/mesh", "/previews/bev.png"):
        assert api_on.get(f"{URL}/{made['id']}{path}", headers=ada.headers).status_code == 404
    again = api_on.delete(f"{URL}/{made['id']}", headers=ada.headers | {"If-Match": "*"})
    assert again.status_code == 404
    for job_id in (added["job"]["id"], run_id):
        assert row_of(platform_on, job_id).state == "cancelled"
    with platform_on.database.reading() as session:
        assert session.query(LabelSet).count() == session.query(Recording).count() == 0
        assert session.get_one(SequenceRow, made["id"]).deleted_ns
    assert sequence(api_on, ada)["id"] != made["id"], "its name is free again"


def test_what_is_done_to_a_sequence_is_in_the_audit_log(
    api: httpx.Client, curator: Person, administrator: Person, forest: Mapping[str, Any]
) -> None:
    match = curator.headers | {"If-Match": "*"}
    api.patch(f"{URL}/{forest['id']}", json={"region": "A"}, headers=match)
    api.delete(f"{URL}/{forest['id']}", headers=match)
    lines = api.get("/api/v1/admin/audit-log", headers=administrator.headers).json()["items"]
    acts = {line["act"] for line in lines if line["subject_id"] == forest["id"]}
    assert acts == {"sequence.create", "sequence.change", "sequence.delete"}
