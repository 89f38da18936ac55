"""A published dataset goes through the queues: whole or absent, done once, nothing left of it when it is over; one
that was cut short goes on where it was, or anew where what it had is of no use any more."""

from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy import select

from services.domain.datasets.catalogue import labelled_sequences
from services.domain.imports.errors import existing_sequences
from services.domain.imports.requests import PUBLISH_IMPORT, SCENE, delete_import, progress_of
from services.domain.sequences.processing import delete_sequence
from services.labeler.imports.queue_handlers import PROFILE
from services.runtime.access.storage_quota import balance
from services.runtime.database.migrate import upgrade
from services.runtime.jobs.control import cancel, retry
from services.runtime.jobs.specs import Attempt, Handler, Outcome
from services.runtime.orm import (
    Artefact,
    Blob,
    Job,
    JobAttempt,
    LabelSet,
    SequenceRow,
)
from services.runtime.platform import Platform
from services.runtime.settings import DatabaseSettings, StoreSettings
from services.runtime.store.blobs import collect_garbage
from services.runtime.store.workspace import Workspace
from services.runtime.uploads import upload_file
from testing.servers.fixtures import make_settings, opened
from testing.worlds.brought_datasets import FIELD, LABELS, BroughtDataset, an_owner, bring_dataset, counts_of, files_of
from testing.worlds.published_datasets import LOGFILE, write_published_tar
from testing.worlds.runs import Interruptions, followed_by, run_all

FRAMES, NOTHING = 4, {"sequences": 0, "label_sets": 0, "artefacts": 0, "labelled_frames": 0, "imported_files": 0}


def without_grace(platform: Platform) -> Platform:
    """A platform whose grace is nothing: whatever may be collected is collected."""
    store = replace(platform.settings.store, grace_s=0.0)
    return replace(platform, settings=platform.settings.model_copy(update={"store": store}))


def test_rows_say_which_sequences_the_scenes_became(imported: BroughtDataset) -> None:
    row, run = imported.row(), imported.run()
    with imported.platform.database.reading() as session:
        sequences = session.scalars(select(SequenceRow).order_by(SequenceRow.name)).all()
        labels = {one.sequence_id: one for one in session.scalars(select(LabelSet))}
        progress = progress_of(session, row)
    assert [one.name for one in sequences] == list(FIELD.names)
    assert [one.region for one in sequences] == ["field"] * 2, "what the log of each says"
    assert {one.owner_id for one in sequences} == {imported.owner_id}
    assert [labels[one.id].frames for one in sequences] == [2, 2]
    assert {one.job_id for one in labels.values()} == {run.id}
    assert {one.parameters["profile"] for one in labels.values()} == {PROFILE}
    assert [scene.sequence_id for scene in progress.scenes] == [one.id for one in sequences]
    assert [(scene.frames, scene.splits, scene.state) for scene in progress.scenes] == [
        (2, ("train",), "succeeded"),
        (2, (), "succeeded"),
    ]
    assert run.result == {"import_id": row.id, "sequences": 2}
    assert (row.blob_sha256, row.finished_ns is not None, progress.done) == (None, True, 2)


def test_labels_are_those_of_the_dataset_to_the_last_byte(imported: BroughtDataset) -> None:
    files = files_of(imported.platform, imported.owner_id)
    for scene, name in enumerate(FIELD.names):
        for frame, token in enumerate(FIELD.tokens(scene)):
            assert files[f"{name}/{token}/labels.npz"] == LABELS[frame]


def test_source_and_labels_are_counted_and_the_tar_is_given_back(imported: BroughtDataset) -> None:
    with imported.platform.database.reading() as session:
        sizes = session.execute(select(Artefact.name, Artefact.size_bytes)).all()
        counted = sum(size for name, size in sizes if name.startswith(("labels/", "source/")))
        assert balance(session, imported.owner_id) == counted > 0


def test_the_tar_and_the_files_of_the_run_are_collected(imported: BroughtDataset) -> None:
    row = imported.row()
    platform = imported.platform
    assert not upload_file(platform.settings, row.upload_id).exists()
    collect_garbage(without_grace(platform))
    with platform.database.reading() as session:
        assert session.get(Blob, row.sha256) is None
    assert list((platform.settings.root / "store" / "work").glob("*/*")) == []
    assert files_of(platform, imported.owner_id), "what was published stays"


@pytest.mark.whole
def test_every_stage_interrupted_once_leaves_the_same(tmp_path: Path, tar: Path, imported: BroughtDataset) -> None:
    """Catches alone a stage that leaves other bytes, or rows twice, after it was killed and done again."""
    other = opened(make_settings(tmp_path / "other"), [])
    upgrade(other.settings)
    brought, interruptions = bring_dataset(other, tar, an_owner(other)), Interruptions(PUBLISH_IMPORT)
    run_all(other, wrap=interruptions.wrap)
    assert len(interruptions.kinds) == 4
    assert (brought.run().state, brought.run().failure) == ("succeeded", "")
    assert files_of(other, brought.owner_id) == files_of(imported.platform, imported.owner_id)
    assert counts_of(other, brought.owner_id) == counts_of(imported.platform, imported.owner_id)
    with other.database.reading() as session:
        lost = session.scalars(select(JobAttempt).where(JobAttempt.outcome == "lost")).all()
    assert len(lost) == 4
    other.database.close()


def test_a_second_import_of_the_same_names_is_refused_naming_all(imported: BroughtDataset, tar: Path) -> None:
    before = counts_of(imported.platform, imported.owner_id)
    again = bring_dataset(imported.platform, tar, imported.owner_id)
    run_all(imported.platform)
    assert (again.run().state, again.run().failure_code) == ("failed", "sequences_exist")
    assert all(name in again.run().failure for name in FIELD.names)
    with imported.platform.database.transaction() as session:
        delete_import(session, again.row())
    assert counts_of(imported.platform, imported.owner_id) == before, "and what it held is given back"


@pytest.mark.whole
def test_of_two_that_race_for_the_names_one_is_published(platform: Platform, tar: Path) -> None:
    owner_id = an_owner(platform)
    both = [bring_dataset(platform, tar, owner_id) for _ in range(2)]
    run_all(platform)
    assert sorted(one.run().state for one in both) == ["failed", "succeeded"]
    assert counts_of(platform, owner_id)["labelled_frames"] == FRAMES


@pytest.mark.whole
def test_labels_are_added_beside_those_that_a_sequence_has(imported: BroughtDataset, tmp_path: Path) -> None:
    other = write_published_tar(tmp_path / "other.tar", replace(FIELD, labels=LABELS[::-1]))
    again = bring_dataset(imported.platform, other, imported.owner_id, existing="add")
    run_all(imported.platform)
    assert again.run().state == "succeeded", again.run().failure
    counts = counts_of(imported.platform, imported.owner_id)
    assert (counts["sequences"], counts["label_sets"], counts["labelled_frames"]) == (2, 4, 2 * FRAMES)


@pytest.mark.whole
def test_the_same_labels_are_not_added_twice(imported: BroughtDataset, tar: Path) -> None:
    before = counts_of(imported.platform, imported.owner_id)
    again = bring_dataset(imported.platform, tar, imported.owner_id, existing="add")
    run_all(imported.platform)
    assert again.run().state == "succeeded"
    assert counts_of(imported.platform, imported.owner_id) == {**before, "dataset_imports": 2}


def test_a_deleted_sequence_leaves_nothing_behind(imported: BroughtDataset) -> None:
    platform = imported.platform
    with platform.database.transaction() as session:
        for sequence in session.scalars(select(SequenceRow)).all():
            delete_sequence(session, sequence)
    with platform.database.transaction() as session:
        delete_import(session, imported.row())
    counts = counts_of(platform, imported.owner_id)
    assert counts == {**NOTHING, "sequences": 2, "dataset_imports": 0, "bytes": 0}, "the rows of sequences stay"
    collect_garbage(without_grace(platform))
    with platform.database.reading() as session:
        assert session.scalars(select(Blob)).all() == []
    assert [path for path in (platform.settings.root / "store").rglob("*") if path.is_file()] == []


@pytest.mark.whole
def test_an_import_that_is_deleted_in_the_middle_leaves_nothing(brought: BroughtDataset) -> None:
    platform, root_id = brought.platform, brought.run().id
    run_all(platform, wrap=followed_by(lambda session: delete_import(session, brought.row()), platform, PUBLISH_IMPORT))
    with platform.database.reading() as session:
        assert session.get_one(Job, root_id).state == "cancelled"
    assert counts_of(platform, brought.owner_id) == {**NOTHING, "dataset_imports": 0, "bytes": 0}


@pytest.mark.release
def test_two_machines_with_s3_and_postgres_make_the_same(
    tar: Path, s3_settings: StoreSettings, fresh_postgres_url: str, tmp_path: Path, imported: BroughtDataset
) -> None:
    """Catches alone an import that depends on which machine, store or database a stage has."""
    groups = {"store": s3_settings, "database": DatabaseSettings(fresh_postgres_url)}
    here, there = (opened(make_settings(tmp_path / name, **groups), []) for name in ("here", "there"))
    upgrade(here.settings)
    brought = bring_dataset(here, tar, an_owner(here))
    run_all(here, there)
    assert (brought.run().state, brought.run().failure) == ("succeeded", "")
    assert files_of(here, brought.owner_id) == files_of(imported.platform, imported.owner_id)
    for machine in (here, there):
        machine.database.close()


@pytest.mark.whole
def test_a_fault_in_the_last_scene_leaves_nothing_and_the_others_are_not_done_again(brought: BroughtDataset) -> None:
    platform, done = brought.platform, list[int]()

    def wrap(kind: str, handler: Handler) -> Handler:
        def run(attempt: Attempt) -> Outcome:
            if attempt.arguments["scene"] == 1 and done.count(1) == 0:
                done.append(1)
                raise existing_sequences(["a fault of this scene"])
            done.append(attempt.arguments["scene"])
            return handler(attempt)

        return run if kind == SCENE else handler

    run_all(platform, wrap=wrap)
    assert (brought.run().state, brought.run().failure_code) == ("failed", "sequences_exist")
    counts = counts_of(platform, brought.owner_id)
    assert (counts["sequences"], counts["label_sets"], counts["labelled_frames"]) == (0, 0, 0)
    with platform.database.transaction() as session:
        retry(session, brought.run().id, 3)
    run_all(platform, wrap=wrap)
    assert brought.run().state == "succeeded"
    assert done == [0, 1, 1], "a scene that is done is not done again"
    assert counts_of(platform, brought.owner_id)["labelled_frames"] == FRAMES


@pytest.mark.whole
def test_a_cancelled_import_goes_on_where_it_was(brought: BroughtDataset) -> None:
    platform, done = brought.platform, list[int]()

    def wrap(kind: str, handler: Handler) -> Handler:
        def run(attempt: Attempt) -> Outcome:
            done.append(attempt.arguments["scene"])
            if done == [0, 1]:
                with platform.database.transaction() as session:
                    cancel(session, attempt.root_id, "")
            return handler(attempt)

        return run if kind == SCENE else handler

    run_all(platform, wrap=wrap)
    assert brought.run().state == "cancelled"
    with platform.database.transaction() as session:
        retry(session, brought.run().id, 3)
    run_all(platform, wrap=wrap)
    assert brought.run().state == "succeeded"
    assert done.count(0) == 1


@pytest.mark.whole
@pytest.mark.parametrize("done", [0, 1, 3])
def test_a_run_of_another_version_is_begun_again_and_ends_as_any(brought: BroughtDataset, done: int) -> None:
    """Catches alone a dataset half of which was imported by the code before an upgrade."""
    platform = brought.platform
    attempts = list[str]()

    def wrap(kind: str, handler: Handler) -> Handler:
        def run(attempt: Attempt) -> Outcome:
            if len(attempts) == done:
                with platform.database.transaction() as session:
                    row = session.get_one(Job, attempt.root_id)
                    row.arguments = {**row.arguments, "code_version": "0.1.0"}
            attempts.append(kind)
            return handler(attempt)

        return run

    old_id = brought.run().id
    run_all(platform, wrap=wrap)
    new = brought.run()
    with platform.database.reading() as session:
        old = session.get_one(Job, old_id)
    assert (old.state, new.state, new.failure) == ("cancelled", "succeeded", "")
    assert new.id != old_id
    assert new.id in old.cancel_reason
    counts = counts_of(platform, brought.owner_id)
    assert (counts["sequences"], counts["labelled_frames"], counts["imported_files"]) == (2, FRAMES, 0)


@pytest.mark.whole
@pytest.mark.parametrize(("kind", "number"), [(SCENE, 1), (PUBLISH_IMPORT, 0)])
def test_a_run_whose_files_are_gone_is_begun_again(brought: BroughtDataset, kind: str, number: int) -> None:
    platform, seen = brought.platform, list[str]()

    def wrap(of: str, handler: Handler) -> Handler:
        def run(attempt: Attempt) -> Outcome:
            if seen.count(kind) == number:
                Workspace(platform.store, platform.settings, attempt.root_id).remove()
            seen.append(of)
            return handler(attempt)

        return run if of == kind else handler

    run_all(platform, wrap=wrap)
    assert (brought.run().state, brought.run().failure) == ("succeeded", "")
    assert counts_of(platform, brought.owner_id)["labelled_frames"] == FRAMES


@pytest.mark.parametrize("is_one", [True, False])
def test_scenes_that_continue_each_other_are_one_drive_and_the_datasets_own_splits_may_not_tear_it(
    platform: Platform, tmp_path: Path, is_one: bool
) -> None:
    """The import succeeds; the draft splits stay as they are, and the run has the code of the rule."""
    splits = {"train": ["field-0000", "field-0002"], "test": ["field-0001"]}
    what = replace(FIELD, scenes=3, drive_scenes=3 if is_one else 1, splits=splits)
    tar = write_published_tar(tmp_path / "chunks.tar", what)
    brought = bring_dataset(platform, tar, an_owner(platform, "administrator"), sets_splits=True)
    run_all(platform)
    with platform.database.reading() as session:
        entries = [one.entry for one in labelled_sequences(session)]
        refused = session.get_one(Job, brought.run().id).result["splits_refused"]
    assert [one.drive for one in entries] == ["field-0000" if is_one else ""] * 3
    assert ("whole_drives" in refused) is is_one
    tracks = [one.track for one in entries if one.track]
    assert [(one.map, one.vehicle, one.log) for one in tracks] == [("dataset:field", "rover", LOGFILE)] * 3
