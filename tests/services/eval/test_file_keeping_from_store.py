"""A submission whose file came into the store is scored as any other, and leaves nothing there but its blob."""

from pathlib import Path

import pytest
from sqlalchemy import func, select

from services.runtime.orm import Upload, UploadPartRow
from services.runtime.uploads.files import remove_file, upload_file
from services.runtime.uploads.store_backend import StoreUploadBackend
from testing.worlds.benchmark_world import World, run_eval
from testing.worlds.sending import guess, row_of, send, zipped


@pytest.fixture(scope="module")
def world(standing: World) -> World:
    return standing


def moved_to_store(world: World, submission_id: str) -> None:
    """As if its file had come into the store."""
    platform = world.platform
    with platform.database.transaction() as session:
        upload = session.get_one(Upload, row_of(platform, submission_id).upload_id)
        upload.backend, upload.state = "store", "open"
        upload.expires_ns = 2**62
    path = upload_file(platform.settings, upload.id)
    held = StoreUploadBackend(platform).hold(upload)
    held.append([path.read_bytes()], 0)
    held.accept(is_whole=True)
    held.close()
    remove_file(path)
    with platform.database.transaction() as session:
        session.get_one(Upload, upload.id).state = "consumed"


def slabs(world: World) -> int:
    with world.platform.database.reading() as session:
        return session.scalar(select(func.count()).select_from(UploadPartRow)) or 0


def copies(world: World) -> list[Path]:
    return [path for path in (world.platform.settings.root / "cache/objects/uploads").rglob("*") if path.is_file()]


def test_it_is_scored_and_its_slabs_go(world: World) -> None:
    submission_id = send(world, zipped(world, guess(world, turn=31)))
    moved_to_store(world, submission_id)
    assert slabs(world) == 1
    run_eval(world.platform)
    row = row_of(world.platform, submission_id)
    assert (row.state, row.blob_sha256) == ("scored", row.declared_sha256)
    assert (slabs(world), copies(world)) == (0, [])


def test_a_file_that_is_gone_is_told(world: World) -> None:
    submission_id = send(world, zipped(world, guess(world, turn=32)))
    moved_to_store(world, submission_id)
    for stored in list(world.platform.store.listed("uploads/")):
        world.platform.store.delete(stored.key)
    run_eval(world.platform)
    row = row_of(world.platform, submission_id)
    assert (row.state, row.failure_code) == ("failed", "upload_damaged")
