"""An upload in the store as other machines meet it: copied to where it is read, its objects shared and given up."""

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy import select

from services.runtime.orm import Recording, UploadPartRow
from services.runtime.platform import Platform
from services.runtime.settings import StoreSettings
from services.runtime.store.factory import open_store
from services.runtime.store.garbage_collection import collect_garbage
from services.runtime.uploads import consume, expire, running_hash
from services.runtime.uploads.backends import backend_of
from tests.services.runtime.uploads.conftest import with_place
from tests.services.runtime.uploads.living import complete, record
from tests.services.runtime.uploads.sending import BAG, CONTENT, kept, made, make_owner, send, sha256_of


@pytest.fixture
def here(platform: Platform) -> Platform:
    """The machine of the API."""
    return at_once(with_place(platform, "store"))


@pytest.fixture
def on_s3(platform: Platform, s3_settings: StoreSettings) -> Platform:
    """As `here`, with a real S3."""
    settings = platform.settings.model_copy(update={"store": replace(s3_settings, grace_s=0.0)})
    return with_place(replace(platform, settings=settings, store=open_store(settings)), "store")


def at_once(platform: Platform) -> Platform:
    """Nothing is spared by the collection."""
    store = replace(platform.settings.store, grace_s=0.0)
    return replace(platform, settings=platform.settings.model_copy(update={"store": store}))


def another_machine(platform: Platform, folder: Path) -> Platform:
    """With a disk of its own, whose settings say nothing of uploads; database and store are the same."""
    settings = platform.settings.model_copy(
        update={"data_folder": folder, "uploads": type(platform.settings.uploads)()}
    )
    settings.__dict__.pop("root", None)
    store = open_store(settings) if settings.store.s3_bucket else platform.store
    return replace(platform, settings=settings, store=store)


def files_of(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file() and path.suffix != ".lock"]


def objects(platform: Platform) -> list[str]:
    return [stored.key for stored in platform.store.listed("")]


def test_whoever_reads_an_upload_has_a_copy_of_their_own_as_long_as_they_do(here: Platform, tmp_path: Path) -> None:
    worker = another_machine(here, tmp_path / "worker")
    upload = complete(here, make_owner(here), CONTENT)
    place = backend_of(worker, upload)
    with ExitStack() as both:
        path = both.enter_context(place.local(upload))
        with place.local(upload) as again:
            assert (again, path.name) == (path, upload.id)
        assert path.read_bytes() == CONTENT
        assert path.is_relative_to(worker.settings.root)
    assert files_of(worker.settings.root) == []
    assert files_of(here.settings.uploads_folder) == []
    with place.local(upload) as path:
        assert path.read_bytes() == CONTENT


def test_an_upload_whose_bytes_are_gone_has_no_copy(here: Platform) -> None:
    upload = complete(here, make_owner(here))
    backend_of(here, upload).remove(upload.id)
    with pytest.raises(FileNotFoundError), backend_of(here, upload).local(upload):
        pass


def test_an_empty_upload_is_an_empty_file(here: Platform) -> None:
    upload = complete(here, make_owner(here), b"")
    with backend_of(here, upload).local(upload) as path:
        assert path.read_bytes() == b""


def test_on_s3_an_upload_comes_in_is_hashed_read_and_given_up(
    on_s3: Platform, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    worker = another_machine(on_s3, tmp_path / "worker")
    upload = made(on_s3, make_owner(on_s3), CONTENT, sha256=sha256_of(CONTENT))
    send(on_s3, upload, 0, CONTENT[:4500])
    monkeypatch.setattr(
        "services.runtime.uploads.reception.ROLLING", running_hash.RollingHashes()
    )  # another replica's turn
    assert send(on_s3, upload, 4500, CONTENT[4500:]).sha256 == sha256_of(CONTENT)
    assert len(objects(on_s3)) == 5 + 6
    with backend_of(worker, upload).local(upload) as path:
        assert path.read_bytes() == CONTENT
    assert files_of(worker.settings.root) == []
    backend_of(worker, upload).remove(upload.id)
    collect_garbage(on_s3)
    assert objects(on_s3) == []


def test_a_file_that_is_kept_is_not_stored_again_and_not_collected_while_an_upload_needs_it(here: Platform) -> None:
    owner = make_owner(here)
    recording = record(here, owner, complete(here, owner))
    expire(here)
    collect_garbage(here)
    (blob_key,) = objects(here)
    again = made(here, owner, BAG, sha256=sha256_of(BAG))
    assert again.state == "complete"
    with here.database.transaction() as session:
        session.delete(session.get_one(Recording, recording.id))
    collect_garbage(here)
    assert objects(here) == [blob_key]
    assert kept(here, again) == BAG
    with backend_of(here, again).local(again) as path:
        assert path == here.store.local(blob_key)
    assert path.read_bytes() == BAG
    backend_of(here, again).remove(again.id)
    collect_garbage(here)
    assert objects(here) == []


def test_the_sweeper_gives_up_what_a_recording_has_kept(here: Platform) -> None:
    owner = make_owner(here)
    kept_upload, waiting = complete(here, owner), complete(here, owner, CONTENT)
    record(here, owner, kept_upload)
    with here.database.transaction() as session:
        consume(session, waiting.id, owner.user_id, "recording")
    expire(here)
    with here.database.reading() as session:
        assert set(session.scalars(select(UploadPartRow.upload_id))) == set()


def test_uploads_stay_where_they_are_when_the_setting_changes(platform: Platform) -> None:
    owner = make_owner(platform)
    began = {place: made(with_place(platform, place), owner, CONTENT) for place in ("folder", "store")}
    for other, upload in (("store", began["folder"]), ("folder", began["store"])):
        changed = with_place(platform, other)
        send(changed, upload, 0, CONTENT[:3000])
        assert send(changed, upload, 3000, CONTENT[3000:]).sha256 == sha256_of(CONTENT)
        assert kept(changed, upload) == CONTENT
