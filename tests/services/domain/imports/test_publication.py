"""How an import ends: what is counted, what a deletion at that moment leaves, which splits follow."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event

import pytest
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.datasets.splits import current_splits
from services.domain.imports.publication import PublishedScene, end_import, follow_splits, sequences_of_scenes
from services.domain.imports.requests import ImportedFacts
from services.domain.sequences.processing import delete_sequence
from services.runtime.access.storage_quota import QuotaExceededError, balance
from services.runtime.orm import DatasetImport, LabelSet, SequenceRow
from services.runtime.platform import Platform
from testing.worlds.brought_datasets import TAR_BYTES, BroughtDataset, an_owner, bring_dataset

LIMIT_BYTES, MINUTE_NS = 2**40, 60_000_000_000


def ended(brought: BroughtDataset, limit_bytes: int = LIMIT_BYTES) -> list[str]:
    """Write label sets of its scenes and end the import, as its stage does; the ids of their sequences."""
    with brought.platform.database.transaction() as session:
        return _ended(session, brought.import_id, limit_bytes)


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
    with pytest.raises(QuotaExceededError):
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
