"""Inputs of a version over HTTP: made when it is published or asked for, of train and val only, and for good."""

import io
import tarfile
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

import httpx
import pytest
from sqlalchemy import select, text
from sqlalchemy.exc import DatabaseError

from services.domain.datasets.inputs import RUN
from services.domain.datasets.queries import dataset_named
from services.domain.sequences.processing import delete_sequence
from services.runtime.orm import AuditEntry, DatasetInput, Job, SequenceRow, Upload
from services.runtime.platform import Platform
from services.runtime.settings import Settings, StoreSettings
from services.runtime.store import blobs
from services.runtime.store.factory import open_store
from services.runtime.store.garbage_collection import collect_garbage
from services.runtime.uploads import upload_file
from testing.api.serving import Person, person
from testing.worlds import made
from testing.worlds.published import dataset, published_sequence
from testing.worlds.rows import recording_of
from tests.api.inputs_made import made_version_input

FILES = {
    "v1.0-trainval/sample.json": b"[]\n",
    "samples/LIDAR_TOP/n001-2026-05-03__LIDAR_TOP__1777800000000000.pcd.bin": bytes(range(256)) * 11,
}
REASON = {"reason": "its recording came back"}


@dataclass(frozen=True)
class Version:
    """A version of a sequence in each part; its sequences by part: ids and names."""

    name: str
    id: str
    ids: Mapping[str, str]
    names: Mapping[str, str]

    @property
    def path(self) -> str:
        return f"/api/v1/datasets/{self.name}/inputs"

    def tar(self, part: str) -> str:
        return f"{self.path}/{self.names[part]}.tar"


@pytest.fixture
def version(platform: Platform, administrator: Person) -> Version:
    return made_version(platform, administrator)


@pytest.fixture
def version_on(platform_on: Platform) -> Version:
    return made_version(platform_on, person(platform_on, "administrator"))


def made_version(platform: Platform, owner: Person) -> Version:
    """Of sequences that were never recorded."""
    ids = {part: published_sequence(platform, owner.user_id) for part in ("train", "val", "test")}
    name = dataset(platform, owner.user_id, {part: [one] for part, one in ids.items()})
    with platform.database.reading() as session:
        found = dataset_named(session, name)
        assert found is not None
        names = {part: session.get_one(SequenceRow, one).name for part, one in ids.items()}
        return Version(name, found.id, ids, names)


def record(platform: Platform, owner: Person, sequence_id: str) -> None:
    """Give the sequence a recording; nothing reads it here."""
    upload_id = made.upload(platform, owner, f"bag of {sequence_id}".encode(), state="consumed")
    with platform.database.transaction() as session:
        blob = blobs.keep(session, platform.store, upload_file(platform.settings, upload_id))
        session.add(recording_of(session.get_one(Upload, upload_id), sequence_id, "registered", blob.sha256))


def start(api: httpx.Client, caller: Person, name: str, **said: Any) -> httpx.Response:
    return api.post(f"/api/v1/admin/datasets/{name}/inputs", json=said or REASON, headers=caller.headers)


def states(api: httpx.Client, caller: Person, version: Version) -> dict[str, tuple[str, str]]:
    items = api.get(version.path, headers=caller.headers).json()["items"]
    return {one["name"]: (one["split"], one["state"]) for one in items}


def test_nobody_reads_inputs_without_an_account_and_only_an_administrator_has_them_made(
    api: httpx.Client, curator: Person, version: Version
) -> None:
    for path in (version.path, version.tar("train")):
        assert api.get(path).status_code == 401
    assert api.post(f"/api/v1/admin/datasets/{version.name}/inputs", json=REASON).status_code == 401
    assert start(api, curator, version.name).status_code == 403


def test_inputs_of_no_version_are_not_found(api: httpx.Client, administrator: Person) -> None:
    assert start(api, administrator, "nothing").status_code == 404
    for path in ("inputs", "inputs/drive.tar"):
        assert api.get(f"/api/v1/datasets/nothing/{path}", headers=administrator.headers).status_code == 404


def test_a_name_that_is_no_sequence_is_refused(api: httpx.Client, participant: Person, version: Version) -> None:
    for name in ("..%2f..%2fetc%2fpasswd", "%00", "a" * 101, ".hidden", "never-there"):
        answer = api.get(f"{version.path}/{name}.tar", headers=participant.headers)
        assert answer.status_code in (404, 422), name


def test_of_a_test_sequence_there_is_nothing_for_anybody_whatever_rows_say(
    api: httpx.Client, platform: Platform, administrator: Person, participant: Person, version: Version
) -> None:
    made_version_input(platform, version.id, version.names["test"], FILES)
    for caller in (participant, administrator):
        assert version.names["test"] not in states(api, caller, version)
        for ask in (api.get, api.head):
            assert ask(version.tar("test"), headers=caller.headers).status_code == 404


def test_inputs_of_test_are_not_even_made(
    api: httpx.Client, platform: Platform, administrator: Person, version: Version
) -> None:
    for one in version.ids.values():
        record(platform, administrator, one)
    run = start(api, administrator, version.name)
    with platform.database.reading() as session:
        jobs = session.scalars(select(Job).where(Job.root_id == run.json()["id"], Job.queue != "")).all()
    assert {job.arguments["name"] for job in jobs} == {version.names[part] for part in ("train", "val")}


def test_what_was_lost_before_is_said_and_the_rest_is_made(
    api: httpx.Client, platform: Platform, administrator: Person, version: Version
) -> None:
    refused = start(api, administrator, version.name)
    assert (refused.status_code, refused.json()["code"]) == (409, "inputs_impossible")
    assert all(version.names[part] in refused.json()["detail"] for part in ("train", "val"))
    record(platform, administrator, version.ids["val"])
    assert states(api, administrator, version) == {
        version.names["train"]: ("train", "lost"),
        version.names["val"]: ("val", "missing"),
    }
    assert start(api, administrator, version.name).status_code == 202


def test_nothing_is_made_twice(api: httpx.Client, platform: Platform, administrator: Person, version: Version) -> None:
    first = made_version_input(platform, version.id, version.names["train"], FILES)
    made_version_input(platform, version.id, version.names["train"], {"samples/other.bin": b"other"})
    with platform.database.reading() as session:
        assert session.get_one(DatasetInput, (version.id, version.names["train"])).tar_sha256 == first.tar[1]
    made_version_input(platform, version.id, version.names["val"], FILES)
    refused = start(api, administrator, version.name)
    assert (refused.status_code, refused.json()["code"]) == (409, "inputs_stand")


def test_what_is_asked_for_is_one_run_and_stands_in_the_log(
    api: httpx.Client, platform: Platform, administrator: Person, version: Version
) -> None:
    record(platform, administrator, version.ids["train"])
    first, second = (start(api, administrator, version.name) for _ in range(2))
    assert (first.status_code, first.json()["kind"]) == (202, RUN)
    assert second.json()["id"] == first.json()["id"]
    assert first.headers["Location"] == f"/api/v1/jobs/{first.json()['id']}"
    with platform.database.reading() as session:
        acts = session.scalars(select(AuditEntry).where(AuditEntry.act == "dataset.inputs")).all()
    assert [(act.subject_id, act.reason) for act in acts] == [(version.id, REASON["reason"])] * 2


def test_a_reason_is_asked_for(api: httpx.Client, administrator: Person, version: Version) -> None:
    assert start(api, administrator, version.name, reason=" ").status_code == 422


def test_a_tar_is_served_whole_in_ranges_and_not_twice(
    api: httpx.Client, platform: Platform, participant: Person, version: Version
) -> None:
    made_version_input(platform, version.id, version.names["train"], FILES)
    (listed,) = (
        one for one in api.get(version.path, headers=participant.headers).json()["items"] if one["state"] == "ready"
    )
    path = version.tar("train")
    whole = api.get(path, headers=participant.headers)
    assert (len(whole.content), sha256(whole.content).hexdigest()) == (listed["tar_bytes"], listed["tar_sha256"])
    assert whole.headers["ETag"] == f'"{listed["tar_sha256"]}"'
    with tarfile.open(fileobj=io.BytesIO(whole.content)) as tar:
        found = {name: tar.extractfile(name).read() for name in tar.getnames()}  # type: ignore[union-attr]
    assert {name: content for name, content in found.items() if name != "sha256sum.txt"} == FILES
    part = api.get(path, headers={**participant.headers, "Range": "bytes=700-1900"})
    assert (part.status_code, part.content) == (206, whole.content[700:1901])
    assert api.get(path, headers={**participant.headers, "If-None-Match": whole.headers["ETag"]}).status_code == 304
    head = api.head(path, headers=participant.headers)
    assert (head.status_code, int(head.headers["Content-Length"])) == (200, len(whole.content))


def test_inputs_are_listed_page_by_page(api: httpx.Client, participant: Person, version: Version) -> None:
    first = api.get(f"{version.path}?limit=1", headers=participant.headers).json()
    second = api.get(f"{version.path}?limit=1&cursor={first['next']}", headers=participant.headers).json()
    names = [one["name"] for one in (*first["items"], *second["items"])]
    assert names == sorted(version.names[part] for part in ("train", "val"))
    assert second["next"] is None


def test_publishing_has_the_inputs_made_of_what_has_its_recording(
    api: httpx.Client, platform: Platform, administrator: Person
) -> None:
    said = {"environment": "lake", "illumination": "dusk"}
    ids = {one: published_sequence(platform, administrator.user_id, region=one, **said) for one in ("train", "val")}
    record(platform, administrator, ids["train"])
    splits = {**{part: [one] for part, one in ids.items()}, "test": [], "reason": "why"}
    match = {**administrator.headers, "If-Match": "*"}
    assert api.put("/api/v1/splits", json=splits, headers=match).status_code == 200
    body = {"name": "stone-1.0", "reason": "release"}
    assert api.post("/api/v1/datasets", json=body, headers=administrator.headers).status_code == 201
    with platform.database.reading() as session:
        (run,) = session.scalars(select(Job).where(Job.kind == RUN))
        jobs = session.scalars(select(Job).where(Job.root_id == run.id, Job.queue != "")).all()
    assert [(job.kind, job.arguments["sequence_id"]) for job in jobs] == [("labeler.inputs", ids["train"])]


def test_inputs_stay_when_their_sequence_is_deleted_and_the_store_is_collected(
    api_on: httpx.Client, platform_on: Platform, version_on: Version
) -> None:
    reader = person(platform_on, "participant")
    made_version_input(platform_on, version_on.id, version_on.names["train"], FILES)
    before = api_on.get(version_on.tar("train"), headers=reader.headers).content
    with platform_on.database.transaction() as session:
        delete_sequence(session, session.get_one(SequenceRow, version_on.ids["train"]))
    hasty = Settings(
        data_folder=platform_on.settings.data_folder,
        database=platform_on.settings.database,
        store=StoreSettings(grace_s=0.0),
    )
    collect_garbage(Platform(hasty, platform_on.database, open_store(hasty)))
    assert api_on.get(version_on.tar("train"), headers=reader.headers).content == before
    assert states(api_on, reader, version_on)[version_on.names["train"]] == ("train", "ready")


@pytest.mark.parametrize("table", ["dataset_inputs", "dataset_input_packs"])
def test_the_database_refuses_to_change_inputs(platform_on: Platform, version_on: Version, table: str) -> None:
    made_version_input(platform_on, version_on.id, version_on.names["train"], FILES)
    with pytest.raises(DatabaseError, match="does not change"):  # noqa: SIM117
        with platform_on.database.transaction() as session:
            session.execute(text(f"UPDATE {table} SET name = name"))
