"""Imports are asked for once, begun again once, counted while they hold a tar, and end whole or not at all."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event
from typing import Any

import pytest
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.datasets.splits import current_splits
from services.domain.imports.publication import PublishedScene, end_import, follow_splits, sequences_of_scenes
from services.domain.imports.requests import (
    IMPORT,
    SCENE,
    ImportedFacts,
    NewImport,
    StatedClasses,
    begin_run_again,
    delete_import,
    import_of_attempt,
    progress_of,
    start_import,
)
from services.domain.sequences.processing import delete_sequence
from services.domain.sequences.restart import MOST_RESTARTS, RESTARTS, RestartedTooOftenError
from services.labeler.imports.answers import DatasetIndexAnswer
from services.runtime.access.storage_quota import balance
from services.runtime.backup.capture import backup_references
from services.runtime.jobs.claims import claim
from services.runtime.jobs.control import cancel, set_mode
from services.runtime.jobs.errors import JobCancelledError, QueueDrainingError
from services.runtime.orm import DatasetImport, Job, LabelSet, SequenceRow, Upload, User
from services.runtime.platform import Platform
from services.runtime.sandbox.errors import SandboxCrashedError
from services.runtime.uploads import expire, upload_file
from testing.refusals import refused_as
from testing.worlds.brought_datasets import TAR_BYTES, BroughtDataset, an_owner, bring_dataset
from testing.worlds.runs import Said, uploaded
from tests.services.runtime.jobs.steps import act


@pytest.fixture
def tar(tmp_path: Path) -> Path:
    """Bytes that nobody opens here."""
    path = tmp_path / "field.tar"
    path.write_bytes(bytes(TAR_BYTES))
    return path


@pytest.fixture
def brought(platform: Platform, tar: Path) -> BroughtDataset:
    return bring_dataset(platform, tar, an_owner(platform))


def asked(platform: Platform, owner_id: str, upload_id: str, **choices: Any) -> str:
    with platform.database.transaction() as session:
        owner = session.get_one(User, owner_id)
        return start_import(session, owner, NewImport(upload_id, **choices))[0].id


def attempt_at(brought: BroughtDataset) -> Said:
    return Said(brought.jobs()[1])


def runs(platform: Platform) -> list[Job]:
    with platform.database.reading() as session:
        return list(session.scalars(select(Job).where(Job.kind == IMPORT).order_by(Job.id)))


def test_stated_classes_are_kept_as_they_were_stated(platform: Platform, tar: Path) -> None:
    stated = StatedClasses("of the lab", {7: "T", 0: "free", 255: "unobserved"})
    brought = bring_dataset(platform, tar, an_owner(platform), name="their data", classes=stated)
    assert brought.row().classes == {"name": "of the lab", "classes": {"0": "free", "7": "T", "255": "unobserved"}}
    assert brought.row().name == "their data"


def test_an_upload_serves_once_and_its_owner_alone(platform: Platform, tar: Path) -> None:
    owner_id, other_id = an_owner(platform), an_owner(platform)
    upload_id = uploaded(platform, owner_id, tar, purpose="dataset")
    with refused_as("upload_missing"):
        asked(platform, other_id, upload_id)
    asked(platform, owner_id, upload_id)
    with refused_as("wrong_upload_state"):
        asked(platform, owner_id, upload_id)
    with refused_as("wrong_upload_purpose"):
        asked(platform, owner_id, uploaded(platform, owner_id, tar))


def test_splits_are_set_by_administrators_alone(platform: Platform, tar: Path) -> None:
    owner_id = an_owner(platform)
    upload_id = uploaded(platform, owner_id, tar, purpose="dataset")
    with refused_as("splits_forbidden"):
        asked(platform, owner_id, upload_id, sets_splits=True)
    administrator_id = an_owner(platform, "administrator")
    assert bring_dataset(platform, tar, administrator_id, sets_splits=True).row().sets_splits


def test_a_queue_that_drains_takes_no_import_and_no_upload(platform: Platform, tar: Path) -> None:
    owner_id = an_owner(platform)
    upload_id = uploaded(platform, owner_id, tar, purpose="dataset")
    act(platform, set_mode, "ingest", "draining")
    with pytest.raises(QueueDrainingError):
        asked(platform, owner_id, upload_id)
    with platform.database.reading() as session:
        assert session.get_one(Upload, upload_id).state == "complete"


def test_the_tar_is_counted_and_kept_until_the_import_is_deleted(brought: BroughtDataset) -> None:
    platform, row = brought.platform, brought.row()
    file = upload_file(platform.settings, row.upload_id)
    expire(platform)
    assert file.exists(), "no blob has its bytes yet"
    with platform.database.reading() as session:
        assert balance(session, brought.owner_id) == TAR_BYTES
        needed = {one.id for one in backup_references(session.connection()).uploads}
    assert needed == {row.upload_id}
    act(platform, delete_import, row)
    with platform.database.reading() as session:
        assert balance(session, brought.owner_id) == 0
        assert backup_references(session.connection()).uploads == ()
    assert runs(platform)[0].state == "cancelled"
    expire(platform)
    assert not file.exists()


def test_progress_is_told_scene_by_scene(brought: BroughtDataset) -> None:
    brought.indexed("a", "b", splits=("train",))
    with brought.platform.database.transaction() as session:
        run = session.get_one(Job, brought.run().id)
        facts = {"root_id": run.id, "owner_id": run.owner_id, "kind": SCENE, "queue": "labeler"}
        session.add(Job(arguments={"scene": 0}, state="succeeded", **facts))
        session.add(Job(arguments={"scene": 1}, state="running", **facts))
    with brought.platform.database.reading() as session:
        progress = progress_of(session, brought.row())
    assert [(scene.name, scene.state, scene.splits) for scene in progress.scenes] == [
        ("a", "succeeded", ("train",)),
        ("b", "running", ("train",)),
    ]
    assert progress.done == 1


def test_of_jobs_that_ask_at_once_one_begins_a_run(platform_on: Platform, tar: Path) -> None:
    brought = bring_dataset(platform_on, tar, an_owner(platform_on))
    platform, attempt, old_id = brought.platform, attempt_at(brought), brought.run().id
    assert act(platform, claim, "ingest") is not None
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda _: begin_run_again(platform, attempt, "for a reason"), range(16)))
    old, new = runs(platform)
    assert (old.id, old.state, new.state) == (old_id, "cancelled", "queued")
    assert new.id in old.cancel_reason
    assert (brought.row().job_id, new.arguments[RESTARTS]) == (new.id, 1)


def test_a_run_is_not_begun_again_without_end(brought: BroughtDataset) -> None:
    platform, attempt = brought.platform, attempt_at(brought)
    with platform.database.transaction() as session:
        run = session.get_one(Job, attempt.root_id)
        run.arguments = {**run.arguments, RESTARTS: MOST_RESTARTS, "code_version": "0.1.0"}
    with pytest.raises(RestartedTooOftenError):
        begin_run_again(platform, attempt, "for a reason")
    with refused_as("code_changed"):
        import_of_attempt(platform, attempt)


def test_a_run_that_is_to_stop_is_not_begun_again(brought: BroughtDataset) -> None:
    platform, attempt = brought.platform, attempt_at(brought)
    act(platform, cancel, brought.run().id, "")
    begin_run_again(platform, attempt, "for a reason")
    assert [run.state for run in runs(platform)] == ["cancelled"]


def test_an_attempt_at_an_import_that_was_deleted_is_cancelled(brought: BroughtDataset) -> None:
    attempt = attempt_at(brought)
    act(brought.platform, delete_import, brought.row())
    begin_run_again(brought.platform, attempt, "for a reason")
    with pytest.raises(JobCancelledError):
        import_of_attempt(brought.platform, attempt)


def test_scenes_that_are_told_twice_or_out_of_order_are_not_believed() -> None:
    def told(*scenes: tuple[int, str]) -> bytes:
        facts = '"frames": 1, "is_labelled": true'
        listed = ", ".join(f'{{"ordinal": {ordinal}, "name": "{name}", {facts}}}' for ordinal, name in scenes)
        return f'{{"scenes": [{listed}]}}'.encode()

    assert len(DatasetIndexAnswer.believed(told((0, "a"), (1, "b"))).scenes) == 2
    for answer in (told(), told((0, "a"), (1, "a")), told((1, "a"))):
        with pytest.raises(SandboxCrashedError):
            DatasetIndexAnswer.believed(answer)


LIMIT_BYTES, MINUTE_NS = 2**40, 60_000_000_000


def ended(brought: BroughtDataset, limit_bytes: int = LIMIT_BYTES) -> list[str]:
    """Write label sets of its scenes and end the import, as its stage does; the ids of their sequences."""
    return act(brought.platform, _ended, brought.import_id, limit_bytes)


def _ended(session: Session, import_id: str, limit_bytes: int = LIMIT_BYTES, duration_ns: int = MINUTE_NS) -> list[str]:
    imported = session.get_one(DatasetImport, import_id)
    made = []
    for sequence in sequences_of_scenes(session, imported):
        facts = {"recipe": import_id, "parameters": {}, "code_version": "1", "frames": 1, "duration_ns": duration_ns}
        labels = LabelSet(sequence_id=sequence.id, job_id=imported.job_id, **facts)
        session.add(labels)
        session.flush()
        made.append(PublishedScene(sequence.id, labels.id, 10))
    end_import(session, imported, made, limit_bytes)
    return [scene.sequence_id for scene in made]


def test_what_would_not_fit_is_not_published(brought: BroughtDataset) -> None:
    brought.indexed("a", "b")
    with refused_as("quota_exceeded"):
        ended(brought, limit_bytes=15)
    with brought.platform.database.reading() as session:
        assert session.scalars(select(SequenceRow)).all() == []
        assert balance(session, brought.owner_id) == TAR_BYTES


def test_a_sequence_that_is_deleted_as_labels_are_added_keeps_none(platform_on: Platform, tar: Path) -> None:
    """Catches alone labels that are added to a sequence between the deletion of its labels and its own."""
    platform, brought = platform_on, bring_dataset(platform_on, tar, an_owner(platform_on))
    (sequence_id,) = ended(brought.indexed("a"))
    again = bring_dataset(platform, tar, brought.owner_id, existing="add").indexed("a")
    is_written, is_deleting = Event(), Event()

    def add() -> None:
        with platform.database.transaction() as session:
            assert _ended(session, again.import_id) == [sequence_id]
            is_written.set()
            assert is_deleting.wait(300)

    def delete() -> None:
        assert is_written.wait(300)
        is_deleting.set()
        with platform.database.transaction() as session:
            delete_sequence(session, session.get_one(SequenceRow, sequence_id))

    with ThreadPoolExecutor(2) as pool:
        for done in (pool.submit(add), pool.submit(delete)):
            done.result()
    with platform.database.reading() as session:
        assert session.scalars(select(LabelSet)).all() == []
        assert session.get_one(SequenceRow, sequence_id).deleted_ns is not None


def test_the_draft_splits_follow_the_dataset_and_keep_what_it_does_not_name(platform: Platform, tar: Path) -> None:
    owner_id = an_owner(platform, "administrator")
    first = bring_dataset(platform, tar, owner_id, sets_splits=True).indexed("a", "b", splits=("train", "all"))
    second = bring_dataset(platform, tar, owner_id, sets_splits=True).indexed("c", splits=("val",))
    ids = [*ended(first), *ended(second)]
    for brought in (first, second):
        with platform.database.transaction() as session:
            assert follow_splits(session, session.get_one(DatasetImport, brought.import_id)) == ()
    with platform.database.reading() as session:
        assert current_splits(session).split.parts == {"train": tuple(ids[:2]), "val": (ids[2],), "test": ()}


def test_a_dataset_without_splits_leaves_those_that_are_there_and_says_so(platform: Platform, tar: Path) -> None:
    brought = bring_dataset(platform, tar, an_owner(platform, "administrator"), sets_splits=True)
    ended(brought.indexed("a", splits=("all",)))
    with platform.database.transaction() as session:
        assert follow_splits(session, session.get_one(DatasetImport, brought.import_id)) == ("no_splits",)
        assert current_splits(session).revision == 0


def test_splits_that_the_rules_forbid_stay_as_they_are(platform: Platform, tar: Path) -> None:
    brought = bring_dataset(platform, tar, an_owner(platform, "administrator"), sets_splits=True)
    brought.indexed("a", splits=("test",))
    with platform.database.transaction() as session:
        _ended(session, brought.import_id, duration_ns=1)
        assert follow_splits(session, session.get_one(DatasetImport, brought.import_id)) == ("sequence_length",)
        assert current_splits(session).revision == 0


def test_what_an_import_says_of_all_goes_before_the_region_of_a_scene(platform: Platform, tar: Path) -> None:
    owner_id, regions = an_owner(platform), dict[str, str]()
    for name, facts in (("a", ImportedFacts()), ("b", ImportedFacts(region="quarry"))):
        brought = bring_dataset(platform, tar, owner_id, facts=facts).indexed(name, region="lake")
        with platform.database.transaction() as session:
            (row,) = sequences_of_scenes(session, session.get_one(DatasetImport, brought.import_id))
            regions[name] = row.region
    assert regions == {"a": "lake", "b": "quarry"}
