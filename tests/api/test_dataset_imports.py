"""Imports over REST: refused with reasons, asked for once, shown as far as they are, forgotten."""

from typing import Any

import httpx
import pytest
from sqlalchemy import select

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


def test_why_the_draft_splits_stayed_as_they_were_is_told(platform: Platform, api: httpx.Client, owner: Person) -> None:
    made = begun(platform, api, owner)
    assert api.get(f"{PATH}/{made['id']}", headers=owner.headers).json()["splits_refused"] is None
    with platform.database.transaction() as session:
        session.get_one(Job, made["job_id"]).result = {"splits_refused": ["test_regions"]}
    assert api.get(f"{PATH}/{made['id']}", headers=owner.headers).json()["splits_refused"] == ["test_regions"]
