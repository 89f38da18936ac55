"""Several uploads that are one bag become one recording: all of them, in one transaction, or none."""

import threading
from collections.abc import Mapping
from hashlib import sha256
from typing import Any

import httpx
import pytest

from services.runtime.access import storage_quota
from services.runtime.orm import Job, Recording, Upload
from services.runtime.platform import Platform
from stone_files.bag_files import MOST_FILES
from testing.api.serving import Person, client_of, person
from testing.worlds.made import NOBODY, row_of, sequence, upload

URL = "/api/v1/sequences"
SPLIT = {"run_1.mcap": b"second", "run_0.mcap": b"first", "metadata.yaml": b"list"}


def sealed(api: httpx.Client, owner: Person, sequence_id: str, body: Mapping[str, Any]) -> httpx.Response:
    return api.post(f"{URL}/{sequence_id}/recordings", json=dict(body), headers=owner.headers)


def uploads(platform: Platform, owner: Person, files: Mapping[str, bytes] = SPLIT) -> list[str]:
    return [upload(platform, owner, content, filename=name) for name, content in files.items()]


def states(platform: Platform, upload_ids: list[str]) -> set[str]:
    with platform.database.reading() as session:
        return {session.get_one(Upload, upload_id).state for upload_id in upload_ids}


@pytest.fixture
def forest(api: httpx.Client, curator: Person) -> dict[str, Any]:
    return sequence(api, curator)


def test_the_files_of_a_bag_become_one_recording_and_one_job(api_on: httpx.Client, platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    made, upload_ids = sequence(api_on, ada), uploads(platform_on, ada)
    answer = sealed(api_on, ada, made["id"], {"upload_ids": upload_ids, "name": "Feldweg 3"})
    assert answer.status_code == 202, answer.text
    recording, job = answer.json()["recording"], answer.json()["job"]
    digests = {name: sha256(content).hexdigest() for name, content in SPLIT.items()}
    lines = "".join(f"{digests[name]}  {name}\n" for name in sorted(SPLIT))
    assert (recording["filename"], recording["size_bytes"]) == ("Feldweg 3", sum(map(len, SPLIT.values())))
    assert recording["sha256"] == sha256(lines.encode()).hexdigest()
    assert [(file["filename"], file["sha256"]) for file in recording["files"]] == sorted(digests.items())
    assert {file["upload_id"] for file in recording["files"]} == set(upload_ids)
    assert row_of(platform_on, job["id"]).arguments == {"recording_id": recording["id"]}
    assert states(platform_on, upload_ids) == {"consumed"}
    shown = api_on.get(answer.headers["location"], headers=ada.headers).json()
    assert shown["files"] == recording["files"]


@pytest.mark.parametrize(
    ("files", "why"),
    [
        ({"a.mcap": b"1", "b.db3": b"2"}, "several kinds are there: .db3, .mcap"),
        ({"a.mcap": b"1", "notes.txt": b"2"}, "notes.txt"),
        ({"metadata.yaml": b"1", "a.db3-wal": b"2"}, "no .mcap, no .db3 and no .bag"),
        ({"a.mcap": b"1", "b.db3-wal": b"2"}, "has no 'b.db3' beside it"),
    ],
)
def test_files_that_are_not_one_bag_are_refused_and_kept(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any], files: dict[str, bytes], why: str
) -> None:
    upload_ids = uploads(platform, curator, files)
    answer = sealed(api, curator, forest["id"], {"upload_ids": upload_ids, "name": "run"})
    assert (answer.status_code, answer.json()["code"]) == (422, "bad_recording_files")
    assert why in answer.json()["detail"]
    assert states(platform, upload_ids) == {"complete"}


def test_two_files_of_one_name_are_refused(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any]
) -> None:
    upload_ids = [upload(platform, curator, content, filename="a.mcap") for content in (b"1", b"2")]
    answer = sealed(api, curator, forest["id"], {"upload_ids": upload_ids, "name": "run"})
    assert answer.json()["code"] == "bad_recording_files"
    twice = sealed(api, curator, forest["id"], {"upload_ids": upload_ids[:1] * 2, "name": "run"})
    assert "named twice" in twice.json()["detail"]
    assert states(platform, upload_ids) == {"complete"}


@pytest.mark.parametrize(
    ("columns", "status", "code"),
    [
        ({"state": "open"}, 409, "wrong_upload_state"),
        ({"purpose": "submission"}, 409, "wrong_upload_purpose"),
        ({"target_id": NOBODY}, 409, "wrong_upload_target"),
    ],
)
def test_one_file_that_cannot_serve_keeps_them_all(
    api_on: httpx.Client, platform_on: Platform, columns: dict[str, str], status: int, code: str
) -> None:
    ada = person(platform_on, "curator")
    made, upload_ids = sequence(api_on, ada), uploads(platform_on, ada)
    spoilt = upload(platform_on, ada, b"3", filename="run_2.mcap", **columns)
    answer = sealed(api_on, ada, made["id"], {"upload_ids": [*upload_ids, spoilt], "name": "run"})
    assert (answer.status_code, answer.json()["code"]) == (status, code)
    assert states(platform_on, upload_ids) == {"complete"}
    with platform_on.database.reading() as session:
        assert session.query(Recording).count() == session.query(Job).count() == 0


def test_somebody_elses_file_in_the_group_does_not_exist(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any]
) -> None:
    theirs = upload(platform, person(platform, "curator"), b"secret", filename="run_2.mcap")
    upload_ids = uploads(platform, curator)
    answer = sealed(api, curator, forest["id"], {"upload_ids": [*upload_ids, theirs], "name": "run"})
    assert (answer.status_code, answer.json()["code"]) == (404, "upload_missing")
    assert states(platform, [*upload_ids, theirs]) == {"complete"}


def test_groups_that_share_a_file_are_sealed_once_however_many_ask(platform_on: Platform) -> None:
    with client_of(platform_on) as api:
        ada = person(platform_on, "curator")
        made, upload_ids = sequence(api, ada), uploads(platform_on, ada)
        answers: list[int] = []

        def seal(number: int) -> None:
            ordered = upload_ids if number % 2 else upload_ids[::-1]
            with httpx.Client(base_url=api.base_url, timeout=300) as own:
                body = {"upload_ids": ordered, "name": f"run-{number}"}
                answers.append(sealed(own, ada, made["id"], body).status_code)

        threads = [threading.Thread(target=seal, args=(number,)) for number in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert sorted(answers) == [202, 409, 409, 409]
    with platform_on.database.reading() as session:
        assert session.query(Recording).count() == session.query(Job).count() == 1


@pytest.mark.parametrize(
    "body",
    [
        {},
        {"upload_id": NOBODY, "upload_ids": [NOBODY, NOBODY], "name": "run"},
        {"upload_ids": [NOBODY], "name": "run"},
        {"upload_ids": [NOBODY, NOBODY]},
        {"upload_id": NOBODY, "name": "run"},
        {"upload_ids": [NOBODY, NOBODY], "name": "../run"},
        {"upload_ids": [NOBODY, NOBODY], "name": ".."},
        {"upload_ids": [NOBODY, NOBODY], "name": "a\u202eb"},
        {"upload_ids": [NOBODY] * (MOST_FILES + 1), "name": "run"},
    ],
)
def test_a_body_that_cannot_be_meant_is_refused(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any], body: dict[str, Any]
) -> None:
    assert sealed(api, curator, forest["id"], body).status_code == 422


def test_a_repeated_seal_under_one_key_is_answered_the_same(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any]
) -> None:
    body = {"upload_ids": uploads(platform, curator), "name": "run"}
    headers = curator.headers | {"Idempotency-Key": "once"}
    first, second = (api.post(f"{URL}/{forest['id']}/recordings", json=body, headers=headers) for _ in range(2))
    assert (first.status_code, second.status_code) == (202, 202)
    assert first.json() == second.json()


def test_a_deleted_group_gives_the_bytes_of_every_file_back(api_on: httpx.Client, platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    made, upload_ids = sequence(api_on, ada), uploads(platform_on, ada)
    with platform_on.database.transaction() as session:
        for upload_id in upload_ids:
            storage_quota.reserve(session, ada.user_id, 5, upload_id, "upload", 100)
    recording = sealed(api_on, ada, made["id"], {"upload_ids": upload_ids, "name": "run"}).json()["recording"]
    path = f"{URL}/{made['id']}/recordings/{recording['id']}"
    assert api_on.delete(path, headers=ada.headers).status_code == 204
    with platform_on.database.reading() as session:
        assert storage_quota.balance(session, ada.user_id) == 0
