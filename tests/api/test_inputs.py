"""Inputs over HTTP, of a version and of a phase: made if they are asked for, read by everybody, of test for nobody."""

import io
import tarfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from typing import Any

import httpx
import pytest
from sqlalchemy import select, text
from sqlalchemy.exc import DatabaseError

from services.domain.benchmarks.phases import inputs as of_phase
from services.domain.benchmarks.phases.phases import NewBenchmark, NewPhase, create_benchmark, create_phase
from services.domain.datasets import input_jobs as of_version
from services.domain.datasets.queries import dataset_named
from services.domain.sequences.processing import delete_sequence
from services.runtime.orm import AuditEntry, Job, SequenceRow, Upload
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
from tests.api.inputs_made import made_input, made_version_input

V1 = "/api/v1"
FILES = {
    "v1.0-trainval/sample.json": b"[]\n",
    "samples/LIDAR_TOP/n001-2026-05-03__LIDAR_TOP__1777800000000000.pcd.bin": bytes(range(256)) * 11,
}
REASON = {"reason": "its recording came back"}


@dataclass(frozen=True)
class Place:
    """A version of a sequence in each part that was never recorded, or a phase over its test; ids and names by part."""

    platform: Platform
    path: str
    subject: str
    run: str
    ids: Mapping[str, str]
    names: Mapping[str, str]
    make: Callable[[str, Mapping[str, bytes]], Any]

    @property
    def act(self) -> str:
        return f"{'phase' if 'phases' in self.path else 'dataset'}.inputs"

    @property
    def inputs(self) -> str:
        return f"{V1}/{self.path}/inputs"

    def start(self, api: httpx.Client, caller: Person) -> httpx.Response:
        return api.post(f"{V1}/admin/{self.path}/inputs", json=REASON, headers=caller.headers)

    def states(self, api: httpx.Client, caller: Person) -> dict[str, tuple[str, str]]:
        items = api.get(self.inputs, headers=caller.headers).json()["items"]
        return {one["name"]: (one["split"], one["state"]) for one in items}

    def record(self, owner: Person, *parts: str) -> None:
        """Give the sequences of these parts a recording; nothing reads it here."""
        for part in parts:
            record(self.platform, owner, self.ids[part])


def record(platform: Platform, owner: Person, sequence_id: str) -> None:
    upload_id = made.upload(platform, owner, f"bag of {sequence_id}".encode(), state="consumed")
    with platform.database.transaction() as session:
        blob = blobs.keep(session, platform.store, upload_file(platform.settings, upload_id))
        session.add(recording_of(session.get_one(Upload, upload_id), sequence_id, "registered", blob.sha256))


def version_of(platform: Platform, owner: Person) -> Place:
    ids = {part: published_sequence(platform, owner.user_id) for part in ("train", "val", "test")}
    name = dataset(platform, owner.user_id, {part: [one] for part, one in ids.items()})
    with platform.database.reading() as session:
        found = dataset_named(session, name)
        assert found is not None
        names = {part: session.get_one(SequenceRow, one).name for part, one in ids.items()}
    make = partial(made_version_input, platform, found.id)
    return Place(platform, f"datasets/{name}", found.id, of_version.RUN, ids, names, make)


def phase_of(platform: Platform, owner: Person) -> Place:
    """A hidden phase over test."""
    version = version_of(platform, owner)
    with platform.database.transaction() as session:
        found = dataset_named(session, version.path.partition("/")[2])
        assert found is not None
        benchmark = create_benchmark(session, NewBenchmark("stone", "STONE", "", owner.user_id))
        phase = create_phase(session, benchmark, found, NewPhase("test", "test", is_hidden=True))
    make = partial(made_input, platform, phase.id)
    return Place(platform, f"phases/{phase.id}", phase.id, of_phase.RUN, version.ids, version.names, make)


@pytest.fixture
def version(platform: Platform, administrator: Person) -> Place:
    return version_of(platform, administrator)


@pytest.fixture(params=[version_of, phase_of])
def place(request: pytest.FixtureRequest, platform: Platform, administrator: Person) -> Place:
    made_place: Place = request.param(platform, administrator)
    return made_place


def test_what_has_no_recording_is_named_and_what_has_is_one_run_in_the_log(
    api: httpx.Client, platform: Platform, administrator: Person, place: Place
) -> None:
    refused = place.start(api, administrator)
    assert (refused.status_code, refused.json()["code"]) == (409, "inputs_impossible")
    lacking = ("test",) if "phases" in place.path else ("train", "val")
    assert all(place.names[part] in refused.json()["detail"] for part in lacking)
    place.record(administrator, *place.ids)
    first, second = (place.start(api, administrator) for _ in range(2))
    assert (first.status_code, first.json()["kind"]) == (202, place.run)
    assert second.json()["id"] == first.json()["id"]
    assert first.headers["Location"] == f"{V1}/jobs/{first.json()['id']}"
    with platform.database.reading() as session:
        acts = session.scalars(select(AuditEntry).where(AuditEntry.act == place.act)).all()
        jobs = session.scalars(select(Job).where(Job.root_id == first.json()["id"], Job.queue != "")).all()
    assert [(act.subject_id, act.reason) for act in acts] == [(place.subject, REASON["reason"])] * 2
    assert {(job.kind, job.arguments["name"]) for job in jobs} == {
        ("labeler.inputs", place.names[part]) for part in lacking
    }, "of a version's test there are not even jobs"


def test_a_tar_is_listed_and_served_whole_in_ranges_and_not_replaced(
    api: httpx.Client, participant: Person, place: Place
) -> None:
    name = place.names["train"]
    first = place.make(name, FILES)
    place.make(name, {"samples/other.bin": b"other"})
    (listed,) = (
        one
        for one in api.get(place.inputs, headers=participant.headers).json()["items"]
        if one.get("state", "ready") == "ready"
    )
    assert (listed["tar_bytes"], listed["tar_sha256"]) == first.tar
    path = f"{place.inputs}/{name}.tar"
    whole = api.get(path, headers=participant.headers)
    assert (len(whole.content), sha256(whole.content).hexdigest()) == first.tar
    assert whole.headers["ETag"] == f'"{listed["tar_sha256"]}"'
    assert f'filename="{name}.tar"' in whole.headers["Content-Disposition"]
    with tarfile.open(fileobj=io.BytesIO(whole.content)) as tar:
        found = {one: tar.extractfile(one).read() for one in tar.getnames()}  # type: ignore[union-attr]
    assert {one: content for one, content in found.items() if one != "sha256sum.txt"} == FILES
    part = api.get(path, headers={**participant.headers, "Range": "bytes=700-1900"})
    assert (part.status_code, part.content) == (206, whole.content[700:1901])
    head = api.head(path, headers=participant.headers)
    assert (head.status_code, int(head.headers["Content-Length"])) == (200, len(whole.content))


def test_inputs_are_listed_page_by_page(api: httpx.Client, participant: Person, place: Place) -> None:
    for part in ("train", "val"):
        place.make(place.names[part], FILES)
    first = api.get(f"{place.inputs}?limit=1", headers=participant.headers).json()
    second = api.get(f"{place.inputs}?limit=1&cursor={first['next']}", headers=participant.headers).json()
    names = [one["name"] for one in (*first["items"], *second["items"])]
    assert (names, second["next"]) == (sorted(place.names[part] for part in ("train", "val")), None)


def test_of_a_versions_test_there_is_nothing_for_anybody_whatever_rows_say(
    api: httpx.Client, administrator: Person, participant: Person, version: Place
) -> None:
    version.make(version.names["test"], FILES)
    for caller in (participant, administrator):
        assert version.names["test"] not in version.states(api, caller)
        for ask in (api.get, api.head):
            assert ask(f"{version.inputs}/{version.names['test']}.tar", headers=caller.headers).status_code == 404


def test_what_was_lost_is_said_and_the_rest_is_made(api: httpx.Client, administrator: Person, version: Place) -> None:
    version.record(administrator, "val")
    train, val = version.names["train"], version.names["val"]
    assert version.states(api, administrator) == {train: ("train", "lost"), val: ("val", "missing")}
    assert version.start(api, administrator).status_code == 202


def test_what_stands_is_not_made_again(api: httpx.Client, administrator: Person, version: Place) -> None:
    for part in ("train", "val"):
        version.make(version.names[part], FILES)
    refused = version.start(api, administrator)
    assert (refused.status_code, refused.json()["code"]) == (409, "inputs_complete")


def test_publishing_has_the_inputs_made_of_what_has_its_recording(
    api: httpx.Client, platform: Platform, administrator: Person
) -> None:
    said = {"environment": "lake", "illumination": "dusk"}
    ids = {one: published_sequence(platform, administrator.user_id, region=one, **said) for one in ("train", "val")}
    record(platform, administrator, ids["train"])
    splits = {**{part: [one] for part, one in ids.items()}, "test": [], "reason": "why"}
    match = {**administrator.headers, "If-Match": "*"}
    assert api.put(f"{V1}/splits", json=splits, headers=match).status_code == 200
    body = {"name": "stone-1.0", "reason": "release"}
    assert api.post(f"{V1}/datasets", json=body, headers=administrator.headers).status_code == 201
    with platform.database.reading() as session:
        (run,) = session.scalars(select(Job).where(Job.kind == of_version.RUN))
        jobs = session.scalars(select(Job).where(Job.root_id == run.id, Job.queue != "")).all()
    assert [(job.kind, job.arguments["sequence_id"]) for job in jobs] == [("labeler.inputs", ids["train"])]


def test_inputs_stay_when_their_sequence_is_deleted_and_the_store_is_collected(
    api: httpx.Client, platform: Platform, participant: Person, version: Place
) -> None:
    version.make(version.names["train"], FILES)
    path = f"{version.inputs}/{version.names['train']}.tar"
    before = api.get(path, headers=participant.headers).content
    with platform.database.transaction() as session:
        delete_sequence(session, session.get_one(SequenceRow, version.ids["train"]))
    hasty = Settings(data_folder=platform.settings.data_folder, store=StoreSettings(grace_s=0.0))
    collect_garbage(Platform(hasty, platform.database, open_store(hasty)))
    assert api.get(path, headers=participant.headers).content == before
    assert version.states(api, participant)[version.names["train"]] == ("train", "ready")


def test_the_database_refuses_to_change_inputs(platform_on: Platform) -> None:
    version = version_of(platform_on, person(platform_on, "administrator"))
    version.make(version.names["train"], FILES)
    for table in ("dataset_inputs", "dataset_input_packs"):
        with pytest.raises(DatabaseError, match="does not change"):  # noqa: SIM117
            with platform_on.database.transaction() as session:
                session.execute(text(f"UPDATE {table} SET name = name"))
