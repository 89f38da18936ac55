"""Deletion of a label set frees its bytes, deletes its products and is refused while something relies on it."""

from collections.abc import Mapping
from typing import Any

import httpx
import pytest
from sqlalchemy import func, select

from services.domain.sequences.label_set_deletion import LabelSetWalk, keep_newest
from services.runtime.access import storage_quota
from services.runtime.access.audit_chain import verify
from services.runtime.jobs.enqueue import enqueue
from services.runtime.jobs.specs import Context, JobSpec
from services.runtime.orm import (
    Artefact,
    AuditEntry,
    Dataset,
    DatasetMember,
    Export,
    Job,
    LabelComparison,
    LabelSet,
    Preview,
    SequenceRow,
    SplitMember,
)
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from testing.api.serving import Person
from testing.servers.fixtures import having
from testing.worlds.benchmark_world import run_eval
from testing.worlds.made import frame_labels, labels, sequence

URL = "/api/v1/sequences"
SETS_BYTES = 1000


@pytest.fixture
def run(api: httpx.Client, curator: Person) -> Mapping[str, Any]:
    return sequence(api, curator)


def two_sets(platform: Platform, run: Mapping[str, Any]) -> tuple[str, str]:
    """Return the older and the newer label set; the newer is active, and both count against their owner."""
    made = [
        labels(platform, run, contents=[frame_labels(kind)] * 2, seed=seed).id for kind, seed in ((1, b"a"), (2, b"b"))
    ]
    with platform.database.transaction() as session:
        owner_id = session.get_one(SequenceRow, run["id"]).owner_id
        for one in made:
            storage_quota.reserve(session, owner_id, SETS_BYTES, one, "label set", 10**9)
    return made[0], made[1]


def delete(api: httpx.Client, caller: Person, run: Mapping[str, Any], label_set_id: str) -> httpx.Response:
    return api.delete(f"{URL}/{run['id']}/label-sets/{label_set_id}", headers=caller.headers)


def refused(reply: httpx.Response) -> str:
    assert (reply.status_code, reply.json()["code"]) == (409, "label_set_pinned")
    return str(reply.json()["detail"])


def balance(platform: Platform, person: Person) -> int:
    with platform.database.reading() as session:
        return storage_quota.balance(session, person.user_id)


def test_what_was_made_of_a_label_set_goes_with_it_and_its_bytes_come_back(
    api: httpx.Client, platform: Platform, curator: Person, run: Mapping[str, Any]
) -> None:
    older, newer = two_sets(platform, run)
    asked = api.post(
        f"{URL}/{run['id']}/label-comparisons", json={"a_id": newer, "b_id": older}, headers=curator.headers
    )
    assert asked.status_code == 202
    before = balance(platform, curator)
    run_eval(platform)
    assert balance(platform, curator) > before
    with platform.database.transaction() as session:
        row = session.get_one(LabelSet, newer)
        blob = session.scalars(select(Artefact.blob_sha256).where(Artefact.label_set_id == newer)).first()
        facts = {"recipe": row.recipe, "name": "sync.svg", "media_type": "image/svg+xml", "size_bytes": 9}
        session.add(Preview(sequence_id=run["id"], recording_id=None, blob_sha256=blob, **facts))
        storage_quota.count(session, curator.user_id, 9, run["id"], "previews")
        job = enqueue(session, JobSpec("labeler.export", {}), Context(curator.user_id, run["id"]))
        made = Export(sequence_id=run["id"], label_set_id=newer, format="playback", recipe="r" * 64, code_version="1")
        made.job_id = job.id
        session.add(made)
    assert delete(api, curator, run, newer).status_code == 204
    assert balance(platform, curator) == SETS_BYTES
    with platform.database.reading() as session:
        for gone in (LabelComparison, Export, Preview):
            assert session.scalar(select(func.count()).select_from(gone)) == 0
        assert session.scalars(select(LabelSet.id)).all() == [older]
        assert session.get_one(Job, job.id).state == "cancelled"
        [line] = session.scalars(select(AuditEntry).where(AuditEntry.act == "label_set.delete"))
        assert (line.subject_id, line.actor) == (newer, curator.name)
    listed = api.get(f"{URL}/{run['id']}/label-sets", headers=curator.headers).json()["items"]
    assert [(one["id"], one["is_counting"]) for one in listed] == [(older, True)]
    assert delete(api, curator, run, newer).status_code == 404


def test_a_label_set_with_an_export_stays_until_the_export_is_deleted(
    api: httpx.Client, platform: Platform, curator: Person, run: Mapping[str, Any]
) -> None:
    _, newer = two_sets(platform, run)
    asked = api.post(f"{URL}/{run['id']}/exports", json={"format": "mesh"}, headers=curator.headers).json()
    assert "its export mesh exists" in refused(delete(api, curator, run, newer))
    export = f"{URL}/{run['id']}/exports/{asked['export']['id']}"
    assert api.delete(export, headers=curator.headers).status_code == 204
    assert delete(api, curator, run, newer).status_code == 204


def test_a_label_set_of_a_version_and_of_a_phase_s_truth_stays(
    api: httpx.Client, platform: Platform, curator: Person, run: Mapping[str, Any]
) -> None:
    older, newer = two_sets(platform, run)
    with platform.database.transaction() as session:
        blob = session.scalars(select(Artefact.blob_sha256)).first()
        version = Dataset(
            name="v1", code_version="1", manifest_sha256=blob, manifest_bytes=1, created_by=curator.user_id
        )
        session.add(version)
        session.flush()
        member = DatasetMember(dataset_id=version.id, sequence_id=run["id"], label_set_id=older, part="val")
        member.name = member.environment = member.illumination = member.region = "x"
        member.recipe, member.frames, member.duration_ns = "r" * 64, 2, 1
        session.add(member)
    assert refused(delete(api, curator, run, older)).count("version v1 of the dataset contains it") == 1
    assert delete(api, curator, run, newer).status_code == 204


@pytest.mark.parametrize("pinned_by", ["public", "splits"])
def test_the_active_label_set_of_what_others_look_at_stays_and_an_older_one_may_go(
    api: httpx.Client, platform: Platform, curator: Person, run: Mapping[str, Any], pinned_by: str
) -> None:
    older, newer = two_sets(platform, run)
    with platform.database.transaction() as session:
        if pinned_by == "public":
            session.get_one(SequenceRow, run["id"]).is_public = True
        else:
            session.add(SplitMember(sequence_id=run["id"], part="train"))
    assert "it is the active label set of" in refused(delete(api, curator, run, newer))
    assert delete(api, curator, run, older).status_code == 204


def test_the_sweeper_keeps_the_newest_sets_and_those_on_which_something_relies(
    api: httpx.Client, platform: Platform, curator: Person, run: Mapping[str, Any]
) -> None:
    made = [labels(platform, run, seed=b"%d" % number).id for number in range(5)]
    for exported in (made[0], made[4]):
        with platform.database.transaction() as session:
            session.get_one(LabelSet, exported).chosen_ns = now_ns()
        asked = api.post(f"{URL}/{run['id']}/exports", json={"format": "mesh"}, headers=curator.headers)
        assert asked.status_code == 202
    with platform.database.transaction() as session:
        session.get_one(LabelSet, made[0]).chosen_ns = 1
    assert keep_newest(platform, LabelSetWalk()) == 0
    kept = having(platform, retention={"label_sets": 2})
    assert keep_newest(kept, LabelSetWalk()) == 1
    assert keep_newest(kept, LabelSetWalk()) == 0
    with platform.database.reading() as session:
        assert sorted(session.scalars(select(LabelSet.id))) == [made[0], made[2], made[3], made[4]]
        [line] = session.scalars(select(AuditEntry).where(AuditEntry.act == "label_set.delete"))
        assert (line.subject_id, line.actor, line.facts["kept"]) == (made[1], "platform", 2)
        assert verify(session) is None


def test_an_older_label_set_counts_once_it_is_activated_and_twice_is_once(
    api: httpx.Client, platform: Platform, curator: Person, run: Mapping[str, Any]
) -> None:
    older, newer = two_sets(platform, run)

    def counting() -> list[str]:
        listed = api.get(f"{URL}/{run['id']}/label-sets", headers=curator.headers).json()["items"]
        return [one["id"] for one in listed if one["is_counting"]]

    assert counting() == [newer]
    for chosen in (older, older, newer):
        reply = api.post(f"{URL}/{run['id']}/label-sets/{chosen}/activate", headers=curator.headers)
        assert (reply.status_code, reply.json()["is_counting"]) == (200, True)
        assert counting() == [chosen]
    with platform.database.reading() as session:
        lines = session.scalars(select(AuditEntry.subject_id).where(AuditEntry.act == "label_set.activate")).all()
    assert list(lines) == [older, older, newer]
