"""Imports over REST: refused with reasons, asked for once, shown as far as they are, forgotten."""

from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import select

from services.runtime.access.storage_quota import balance
from services.runtime.orm import AuditEntry, DatasetImport, Job
from services.runtime.platform import Platform
from testing.api.serving import Person, client_of, person
from testing.worlds import made
from testing.worlds.placed import in_folder

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


def test_an_archive_in_place_is_asked_for_by_its_place_and_is_not_counted(
    platform: Platform, owner: Person, tmp_path: Path
) -> None:
    body = {"in_place": {"root": "nas", "path": "released/STONE.zip"}, "layout": "release", "grid": "occ3d"}
    with client_of(in_folder(platform, tmp_path)) as api:
        answer = api.post(PATH, json=body, headers=owner.headers)
        refusals = [
            api.post(PATH, json=one, headers=owner.headers)
            for one in (
                {"in_place": {"root": "disk", "path": "STONE.zip"}},
                {"in_place": {"root": "nas", "path": "STONE"}},
                {"in_place": {"root": "nas", "path": "../STONE.zip"}},
                {**body, "upload_id": "0" * 32},
                {},
            )
        ]
    assert answer.status_code == 202, answer.text
    made = answer.json()
    facts = {"name": "STONE", "place": body["in_place"], "layout": "release", "grid": "occ3d", "size_bytes": 0}
    assert {key: made[key] for key in facts} == facts
    told = [(one.status_code, one.json()["code"]) for one in refusals]
    assert told == [(422, "unknown_root"), (422, "no_archive"), (422, "bad_place"), *[(422, "invalid_request")] * 2]
    with platform.database.reading() as session:
        assert balance(session, owner.user_id) == 0
        (entry,) = session.scalars(select(AuditEntry))
        assert entry.facts["place"] == "nas:released/STONE.zip"
