"""Recordings: an upload becomes one, once, of its owner, in one transaction with the job that reads it."""

import threading
from collections.abc import Mapping
from typing import Any

import httpx
import pytest

from services.runtime.access import storage_quota
from services.runtime.orm import Job, Queue, Recording, Upload
from services.runtime.platform import Platform
from testing.api.serving import Person, client_of, person
from testing.worlds.made import NOBODY, row_of, sequence, upload

URL = "/api/v1/sequences"


@pytest.fixture
def forest(api: httpx.Client, curator: Person) -> dict[str, Any]:
    return sequence(api, curator)


def added(api: httpx.Client, owner: Person, sequence_id: str, upload_id: str) -> httpx.Response:
    return api.post(f"{URL}/{sequence_id}/recordings", json={"upload_id": upload_id}, headers=owner.headers)


def test_nobody_without_a_token_adds_or_sees_one(api: httpx.Client) -> None:
    path = f"{URL}/{NOBODY}/recordings"
    assert api.post(path, json={"upload_id": NOBODY}).status_code == 401
    for method, below in (("GET", ""), ("GET", f"/{NOBODY}"), ("DELETE", f"/{NOBODY}")):
        assert api.request(method, path + below).status_code == 401


def test_a_participant_neither_adds_nor_deletes(api: httpx.Client, participant: Person) -> None:
    assert added(api, participant, NOBODY, NOBODY).status_code == 403
    gone = api.delete(f"{URL}/{NOBODY}/recordings/{NOBODY}", headers=participant.headers)
    assert gone.status_code == 403


def test_what_is_somebody_elses_does_not_exist(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any]
) -> None:
    other = person(platform, "curator")
    own, theirs = sequence(api, other), upload(platform, curator)
    assert added(api, other, forest["id"], upload(platform, other)).status_code == 404
    stolen = added(api, other, own["id"], theirs)
    assert (stolen.status_code, stolen.json()["code"]) == (404, "upload_missing")
    recording = added(api, curator, forest["id"], theirs).json()["recording"]
    path = f"/recordings/{recording['id']}"
    for sequence_id in (forest["id"], own["id"]):
        assert api.get(f"{URL}/{sequence_id}{path}", headers=other.headers).status_code == 404
        assert api.delete(f"{URL}/{sequence_id}{path}", headers=other.headers).status_code == 404
    assert api.get(f"{URL}/{forest['id']}/recordings", headers=other.headers).status_code == 404
    assert api.get(f"{URL}/{forest['id']}{path}", headers=curator.headers).status_code == 200


@pytest.mark.parametrize(
    ("columns", "status", "code"),
    [
        ({"state": "open"}, 409, "wrong_upload_state"),
        ({"state": "expired"}, 409, "wrong_upload_state"),
        ({"purpose": "submission"}, 409, "wrong_upload_purpose"),
        ({"target_id": NOBODY}, 409, "wrong_upload_target"),
    ],
)
def test_an_upload_that_cannot_serve_is_refused_and_kept(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any], columns: dict[str, str],
    status: int, code: str,
) -> None:  # fmt: skip
    upload_id = upload(platform, curator, **columns)
    answer = added(api, curator, forest["id"], upload_id)
    assert (answer.status_code, answer.json()["code"]) == (status, code)
    with platform.database.reading() as session:
        assert session.get_one(Upload, upload_id).state == columns.get("state", "complete")
        assert session.query(Recording).count() == session.query(Job).count() == 0


def test_a_draining_queue_takes_neither_the_upload_nor_the_job(api_on: httpx.Client, platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    made, upload_id = sequence(api_on, ada), upload(platform_on, ada)
    with platform_on.database.transaction() as session:
        session.add(Queue(name="ingest", mode="draining"))
    answer = added(api_on, ada, made["id"], upload_id)
    assert (answer.status_code, answer.json()["code"]) == (409, "queue_draining")
    with platform_on.database.transaction() as session:
        assert session.get_one(Upload, upload_id).state == "complete"
        assert session.query(Recording).count() == session.query(Job).count() == 0
        session.get_one(Queue, "ingest").mode = "open"
    assert added(api_on, ada, made["id"], upload_id).status_code == 202


def test_of_requests_that_use_an_upload_at_once_one_does(platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    with client_of(platform_on) as api:
        made, upload_id = sequence(api, ada), upload(platform_on, ada)
        answers: list[int] = []

        def add() -> None:
            with httpx.Client(base_url=api.base_url, timeout=300) as own:
                answers.append(added(own, ada, made["id"], upload_id).status_code)

        threads = [threading.Thread(target=add) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert sorted(answers) == [202, 409, 409, 409]
    with platform_on.database.reading() as session:
        assert session.query(Recording).count() == session.query(Job).count() == 1


def test_a_recording_comes_with_the_job_that_reads_it(
    api_on: httpx.Client, platform_on: Platform, bells: list[tuple[str, int]]
) -> None:
    ada = person(platform_on, "curator")
    made = sequence(api_on, ada)
    upload_id = upload(platform_on, ada, b"bytes", filename="läuft.mcap", target_id=made["id"])
    answer = added(api_on, ada, made["id"], upload_id)
    body = answer.json()
    recording, job = body["recording"], body["job"]
    assert answer.status_code == 202
    assert answer.headers["location"] == f"{URL}/{made['id']}/recordings/{recording['id']}"
    assert (recording["state"], recording["filename"], recording["size_bytes"]) == ("received", "läuft.mcap", 5)
    assert (job["kind"], job["state"], job["sequence_id"]) == ("ingest.register", "queued", made["id"])
    assert row_of(platform_on, job["id"]).arguments == {"recording_id": recording["id"]}
    assert bells == [("ingest", 1)]
    shown = api_on.get(answer.headers["location"], headers=ada.headers).json()
    assert shown == {**recording, "inspection": None, "quality": None, "previews": []}
    listed = api_on.get(f"{URL}/{made['id']}/recordings", headers=ada.headers).json()
    assert listed == {"items": [recording], "next": None}


def test_a_repeated_request_under_one_key_is_answered_the_same(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any]
) -> None:
    body = {"upload_id": upload(platform, curator)}
    headers = curator.headers | {"Idempotency-Key": "once"}
    first, second = (api.post(f"{URL}/{forest['id']}/recordings", json=body, headers=headers) for _ in range(2))
    assert (first.status_code, second.status_code) == (202, 202)
    assert first.json() == second.json()
    assert second.headers["idempotency-replayed"] == "true"


def test_a_recording_is_not_taken_from_under_a_run(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any]
) -> None:
    recording = added(api, curator, forest["id"], upload(platform, curator)).json()["recording"]
    with platform.database.transaction() as session:
        run = Job(kind="sequence.process", owner_id=curator.user_id, sequence_id=forest["id"], state="running")
        run.id = run.root_id = "ab" * 16
        run.arguments = {"recording_id": recording["id"]}
        session.add(run)
    path = f"{URL}/{forest['id']}/recordings/{recording['id']}"
    answer = api.delete(path, headers=curator.headers)
    assert (answer.status_code, answer.json()["code"]) == (409, "recording_in_use")
    assert api.get(path, headers=curator.headers).status_code == 200


def test_a_deleted_recording_gives_its_bytes_back_and_stops_its_job(
    api_on: httpx.Client, platform_on: Platform
) -> None:
    ada = person(platform_on, "curator")
    made, upload_id = sequence(api_on, ada), upload(platform_on, ada)
    with platform_on.database.transaction() as session:
        storage_quota.reserve(session, ada.user_id, 3, upload_id, "upload", 10)
    body = added(api_on, ada, made["id"], upload_id).json()
    path = f"{URL}/{made['id']}/recordings/{body['recording']['id']}"
    assert api_on.delete(path, headers=ada.headers).status_code == 204
    assert api_on.delete(path, headers=ada.headers).status_code == 404
    assert row_of(platform_on, body["job"]["id"]).state == "cancelled"
    with platform_on.database.reading() as session:
        assert storage_quota.balance(session, ada.user_id) == 0
    again = added(api_on, ada, made["id"], upload_id)
    assert again.json()["code"] == "wrong_upload_state", "an upload serves once, even then"
