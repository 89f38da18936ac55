"""Inputs of a phase over HTTP: asked for by an administrator, read by everybody, whole or in ranges, for good."""

import io
import tarfile
from hashlib import sha256
from typing import Any

import httpx
import pytest
from sqlalchemy import select

from services.domain.benchmarks.phases.inputs import RUN
from services.domain.benchmarks.phases.phases import NewBenchmark, NewPhase, create_benchmark, create_phase
from services.domain.datasets.queries import dataset_named
from services.runtime.orm import AuditEntry, Job, PhaseInput, SequenceRow, Upload
from services.runtime.platform import Platform
from services.runtime.store import blobs
from services.runtime.uploads import upload_file
from testing.api.serving import Person
from testing.worlds import made
from testing.worlds.made import NOBODY
from testing.worlds.published import dataset, published_sequence
from testing.worlds.rows import recording_of
from tests.api.inputs_made import made_input

FILES = {
    "v1.0-trainval/sample.json": b"[]\n",
    "samples/LIDAR_TOP/n001-2026-05-03__LIDAR_TOP__1777800000000000.pcd.bin": bytes(range(256)) * 11,
}
REASON = {"reason": "the season begins"}


@pytest.fixture
def phase_id(platform: Platform, administrator: Person) -> str:
    """A hidden phase over a sequence that was never recorded."""
    ids = {"test": [published_sequence(platform, administrator.user_id)]}
    name = dataset(platform, administrator.user_id, ids)
    with platform.database.transaction() as session:
        version = dataset_named(session, name)
        assert version is not None
        benchmark = create_benchmark(session, NewBenchmark("stone", "STONE", "", administrator.user_id))
        return create_phase(session, benchmark, version, NewPhase("test", "test", is_hidden=True)).id


def record(platform: Platform, owner: Person) -> None:
    """Give the sequence a recording; nothing reads it here."""
    upload_id = made.upload(platform, owner, b"bag", state="consumed")
    with platform.database.transaction() as session:
        blob = blobs.keep(session, platform.store, upload_file(platform.settings, upload_id))
        sequence_id = session.scalars(select(SequenceRow.id)).one()
        session.add(recording_of(session.get_one(Upload, upload_id), sequence_id, "registered", blob.sha256))


def ask(api: httpx.Client, caller: Person, path: str, **headers: str) -> httpx.Response:
    return api.get(f"/api/v1/phases/{path}", headers=caller.headers | headers)


def start(api: httpx.Client, caller: Person, phase_id: str, **said: Any) -> httpx.Response:
    return api.post(f"/api/v1/admin/phases/{phase_id}/inputs", json=said or REASON, headers=caller.headers)


def test_only_an_administrator_has_inputs_made(api: httpx.Client, curator: Person, phase_id: str) -> None:
    assert start(api, curator, phase_id).status_code == 403
    assert api.post(f"/api/v1/admin/phases/{phase_id}/inputs", json=REASON).status_code == 401


def test_inputs_of_no_phase_are_not_found(api: httpx.Client, administrator: Person) -> None:
    assert start(api, administrator, NOBODY).status_code == 404
    assert ask(api, administrator, f"{NOBODY}/inputs").status_code == 404
    assert ask(api, administrator, f"{NOBODY}/inputs/drive.tar").status_code == 404


def test_a_reason_is_asked_for(api: httpx.Client, administrator: Person, phase_id: str) -> None:
    assert start(api, administrator, phase_id, reason=" ").status_code == 422


def test_a_sequence_without_a_recording_is_named(api: httpx.Client, administrator: Person, phase_id: str) -> None:
    refused = start(api, administrator, phase_id)
    assert (refused.status_code, refused.json()["code"]) == (409, "inputs_impossible")
    assert "open-" in refused.json()["detail"]


def test_a_name_that_is_no_sequence_is_refused_before_anything_is_looked_up(
    api: httpx.Client, participant: Person, phase_id: str
) -> None:
    for name in ("..%2f..%2fetc%2fpasswd", "%00", "a" * 101, ".hidden"):
        assert ask(api, participant, f"{phase_id}/inputs/{name}.tar").status_code in (404, 422), name


def test_inputs_are_listed_by_name(api: httpx.Client, platform: Platform, participant: Person, phase_id: str) -> None:
    assert ask(api, participant, f"{phase_id}/inputs").json() == {"items": [], "next": None}
    for name in ("quarry", "drive"):
        made_input(platform, phase_id, name, FILES)
    first = ask(api, participant, f"{phase_id}/inputs?limit=1").json()
    second = ask(api, participant, f"{phase_id}/inputs?limit=1&cursor={first['next']}").json()
    assert [one["name"] for one in (*first["items"], *second["items"])] == ["drive", "quarry"]
    assert second["next"] is None
    assert first["items"][0]["size_bytes"] > sum(map(len, FILES.values())), "the checksums count too"


def test_a_tar_is_served_whole_in_ranges_and_not_twice(
    api: httpx.Client, platform: Platform, participant: Person, phase_id: str
) -> None:
    made_input(platform, phase_id, "drive", FILES)
    path = f"{phase_id}/inputs/drive.tar"
    listed = ask(api, participant, f"{phase_id}/inputs").json()["items"][0]
    whole = ask(api, participant, path)
    assert sha256(whole.content).hexdigest() == listed["tar_sha256"]
    assert (len(whole.content), whole.headers["ETag"]) == (listed["tar_bytes"], f'"{listed["tar_sha256"]}"')
    assert 'filename="drive.tar"' in whole.headers["Content-Disposition"]
    with tarfile.open(fileobj=io.BytesIO(whole.content)) as tar:
        found = {name: tar.extractfile(name).read() for name in tar.getnames()}  # type: ignore[union-attr]
    assert {name: content for name, content in found.items() if name != "sha256sum.txt"} == FILES
    part = ask(api, participant, path, Range="bytes=700-1900")
    assert (part.status_code, part.content) == (206, whole.content[700:1901])
    assert ask(api, participant, path, **{"If-None-Match": whole.headers["ETag"]}).status_code == 304
    assert ask(api, participant, path, Range=f"bytes={len(whole.content)}-").status_code == 416
    head = api.head(f"/api/v1/phases/{path}", headers=participant.headers)
    assert (head.status_code, int(head.headers["Content-Length"])) == (200, len(whole.content))
    assert ask(api, participant, f"{phase_id}/inputs/other.tar").status_code == 404


def test_what_is_asked_for_is_one_run_and_stands_in_the_log(
    api: httpx.Client, platform: Platform, administrator: Person, phase_id: str
) -> None:
    record(platform, administrator)
    first, second = (start(api, administrator, phase_id) for _ in range(2))
    assert (first.status_code, first.json()["kind"]) == (202, RUN)
    assert second.json()["id"] == first.json()["id"]
    assert first.headers["Location"] == f"/api/v1/jobs/{first.json()['id']}"
    with platform.database.reading() as session:
        acts = session.scalars(select(AuditEntry).where(AuditEntry.act == "phase.inputs")).all()
        jobs = session.scalars(select(Job).where(Job.root_id == first.json()["id"], Job.queue != "")).all()
    assert [(act.subject_id, act.reason) for act in acts] == [(phase_id, REASON["reason"])] * 2
    assert [job.kind for job in jobs] == ["labeler.inputs"]
    assert ask(api, administrator, f"{phase_id}/inputs").json()["items"] == []


def test_an_input_that_stands_is_not_replaced(platform: Platform, phase_id: str) -> None:
    first = made_input(platform, phase_id, "drive", FILES)
    made_input(platform, phase_id, "drive", {"samples/other.bin": b"other"})
    with platform.database.reading() as session:
        row = session.get_one(PhaseInput, (phase_id, "drive"))
    assert (row.tar_sha256, row.index_sha256) == (first.tar[1], first.index.sha256)
