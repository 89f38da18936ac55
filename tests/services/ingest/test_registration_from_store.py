"""A recording whose bytes came into the store is read by workers that share nothing but database and store."""

from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy import func, select

from services.domain.sequences.recordings import NewRecording, add_recording
from services.runtime.orm import Blob, QuotaEntry, UploadPartRow
from services.runtime.platform import Platform
from services.runtime.settings import Settings
from services.runtime.store.garbage_collection import collect_garbage
from services.runtime.uploads import expire
from services.runtime.uploads.creation import UploadDeclaration, create
from services.runtime.uploads.rows import UploadOwner
from testing.worlds.drives import drive
from testing.worlds.runs import Brought, bring, run_all
from tests.services.runtime.uploads.conftest import with_place
from tests.services.runtime.uploads.sending import send


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory)


@pytest.fixture
def worker(platform: Platform, tmp_path: Path) -> Platform:
    """A machine with a disk of its own, whose settings say nothing of uploads."""
    settings = platform.settings.model_copy(update={"data_folder": tmp_path / "worker"})
    settings.__dict__.pop("root", None)
    return replace(platform, settings=settings)


def sent(platform: Platform, content: bytes) -> tuple[Brought, str]:
    """A sequence with a recording that came into the store; the id of the job that reads it."""
    brought = bring(with_place(platform, "store", part_bytes=len(content) // 3))
    upload = create(
        brought.platform, UploadOwner(brought.owner_id), UploadDeclaration("run.mcap", "recording", len(content))
    )
    send(brought.platform, upload, 0, content)
    with platform.database.transaction() as session:
        received = NewRecording((upload.id,), "run.mcap")
        recording, job = add_recording(session, brought.sequence(), received, brought.owner_id)
    brought.recording_ids.append(recording.id)
    return brought, job.id


def slabs(platform: Platform) -> int:
    with platform.database.reading() as session:
        return session.scalar(select(func.count()).select_from(UploadPartRow)) or 0


def copies(worker: Platform) -> list[Path]:
    return [path for path in (worker.settings.root / "cache/objects").rglob("*") if path.is_file()]


@pytest.mark.whole
def test_it_is_registered_and_neither_copy_nor_slab_stays(platform: Platform, worker: Platform, bag: Path) -> None:
    brought, job_id = sent(platform, bag.read_bytes())
    assert slabs(platform) >= 3
    run_all(worker)
    assert (brought.job(job_id).state, brought.recording().state) == ("succeeded", "registered")
    assert copies(worker) == []
    expire(brought.platform)
    collect_garbage(replace(platform, settings=at_once(platform)))
    assert slabs(platform) == 0
    assert list(platform.store.listed("uploads/")) == []
    with platform.database.reading() as session:
        key = session.get_one(Blob, brought.recording().sha256).object_key
    assert b"".join(platform.store.read(key)) == bag.read_bytes()


def test_what_is_no_bag_is_refused_and_given_up(platform: Platform, worker: Platform) -> None:
    brought, job_id = sent(platform, b"<!doctype html><title>Sign in</title>" * 10)
    run_all(worker)
    assert (brought.job(job_id).failure_code, brought.recording().state) == ("BAG-001", "refused")
    assert (slabs(platform), copies(worker)) == (0, [])
    with platform.database.reading() as session:
        assert session.scalar(select(func.sum(QuotaEntry.amount))) == 0


def test_bytes_that_are_gone_are_said_to_be(platform: Platform, worker: Platform, bag: Path) -> None:
    brought, job_id = sent(platform, bag.read_bytes())
    for stored in list(platform.store.listed("uploads/")):
        platform.store.delete(stored.key)
    run_all(worker)
    assert brought.job(job_id).failure_code == "recording_file_missing"


def at_once(platform: Platform) -> Settings:
    """Settings with which nothing is spared by the collection."""
    return platform.settings.model_copy(update={"store": replace(platform.settings.store, grace_s=0.0)})
