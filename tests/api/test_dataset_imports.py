"""Imports over REST: refused with reasons, asked for once, shown as far as they are, forgotten."""

from typing import Any

import httpx
import pytest
from sqlalchemy import select

from services.runtime.jobs.completion import Failure, fail_run
from services.runtime.orm import AuditEntry, DatasetImport, Job
from services.runtime.platform import Platform
from testing.api.serving import Person, person
from testing.worlds import made

TAR = b"the bytes of a tar"
PATH = "/api/v1/dataset-imports"


@pytest.fixture
def owner(platform: Platform) -> Person:
    return person(platform, "curator")


def sent(platform: Platform, owner: Person, **columns: Any) -> str:
    return made.upload(platform, owner, TAR, **{"purpose": "dataset", "filename": "offroad.tar"} | columns)


def asked(api: httpx.Client, owner: Person, upload_id: str, **said: Any) -> httpx.Response:
    return api.post(PATH, json={"upload_id": upload_id, **said}, headers=owner.headers)


def begun(platform: Platform, api: httpx.Client, owner: Person, **said: Any) -> dict[str, Any]:
    answer = asked(api, owner, sent(platform, owner), **said)
    assert answer.status_code == 202, answer.text
    made: dict[str, Any] = answer.json()
    return made


def test_an_upload_that_is_no_dataset_is_refused(platform: Platform, api: httpx.Client, owner: Person) -> None:
    for columns, status, code in [
        ({"purpose": "recording"}, 409, "wrong_upload_purpose"),
        ({"state": "open"}, 409, "wrong_upload_state"),
        ({"state": "consumed"}, 409, "wrong_upload_state"),
    ]:
        answer = asked(api, owner, sent(platform, owner, **columns))
        assert (answer.status_code, answer.json()["code"]) == (status, code)


def test_an_import_says_what_it_was_asked_for(platform: Platform, api: httpx.Client, owner: Person) -> None:
    facts = {"environment": "mountain", "illumination": "day", "region": "Gyeonggi", "platform": "warthog-1"}
    facts |= {"is_public": True}
    classes = "name: theirs\nclasses: {17: free, 11: T}\n"
    body = {"upload_id": sent(platform, owner), "existing": "add", "classes": classes, **facts}
    made = api.post(PATH, json=body, headers=owner.headers).json()
    told = {name: made[name] for name in ("name", "existing", "classes", "state", "scenes_total", "scenes", "failure")}
    assert told == {
        "name": "offroad", "existing": "add", "classes": "theirs", "state": "queued", "scenes_total": None,
        "scenes": [], "failure": None,
    }  # fmt: skip
    assert api.get(f"{PATH}/{made['id']}", headers=owner.headers).json() == made
    assert api.get(f"/api/v1/jobs/{made['job_id']}", headers=owner.headers).json()["kind"] == "dataset.import"
    with platform.database.reading() as session:
        row = session.get_one(DatasetImport, made["id"])
        assert row.classes == {"name": "theirs", "classes": {"11": "T", "17": "free"}}
        assert row.facts == facts
        acts = list(session.scalars(select(AuditEntry.act)))
    assert acts == ["dataset_import.create"]


def test_how_far_it_is_is_said_scene_by_scene(platform: Platform, api: httpx.Client, owner: Person) -> None:
    import_id = begun(platform, api, owner)["id"]
    with platform.database.transaction() as session:
        row = session.get_one(DatasetImport, import_id)
        row.scenes = [{"name": f"field-{n}", "frames": 3 + n, "splits": ["val"]} for n in range(2)]
        for scene, state in enumerate(("succeeded", "running")):
            job = Job(root_id=row.job_id, owner_id=owner.user_id, kind="labeler.import_scene", queue="labeler")
            job.state, job.arguments = state, {"scene": scene}
            session.add(job)
    shown = api.get(f"{PATH}/{import_id}", headers=owner.headers).json()
    assert [(one["name"], one["frames"], one["state"]) for one in shown["scenes"]] == [
        ("field-0", 3, "succeeded"),
        ("field-1", 4, "running"),
    ]
    assert (shown["scenes_total"], shown["scenes_done"], shown["frames"]) == (2, 1, 7)
    (listed,) = api.get(PATH, headers=owner.headers).json()["items"]
    assert listed == {key: value for key, value in shown.items() if key not in ("scenes", "splits_refused")}


def test_why_the_draft_splits_stayed_as_they_were_is_told(platform: Platform, api: httpx.Client, owner: Person) -> None:
    made = begun(platform, api, owner)
    assert api.get(f"{PATH}/{made['id']}", headers=owner.headers).json()["splits_refused"] is None
    with platform.database.transaction() as session:
        session.get_one(Job, made["job_id"]).result = {"splits_refused": ["test_regions"]}
    assert api.get(f"{PATH}/{made['id']}", headers=owner.headers).json()["splits_refused"] == ["test_regions"]


def test_what_was_wrong_is_the_failure_with_its_code_and_place(
    platform: Platform, api: httpx.Client, owner: Person
) -> None:
    made = begun(platform, api, owner)
    with platform.database.transaction() as session:
        run = session.get_one(Job, made["job_id"])
        index = session.scalars(select(Job).where(Job.root_id == run.id, Job.id != run.id)).one()
        index.state = "failed"
        fail_run(session, run, index.id, Failure("DST-018", "v1.0-trainval/sample.json row 3 (token 00ff): twice"))
    for one in (api.get(f"{PATH}/{made['id']}", headers=owner.headers).json(), *listed(api, owner)):
        assert one["failure"]["code"] == "DST-018"
        assert one["failure"]["sentence"].startswith("v1.0-trainval/sample.json row 3")


def listed(api: httpx.Client, owner: Person) -> list[dict[str, Any]]:
    items: list[dict[str, Any]] = api.get(PATH, headers=owner.headers).json()["items"]
    return items
