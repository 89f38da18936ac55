"""Storing the same content again detects and replaces a decayed object, in a folder and in a bucket."""

from pathlib import Path

import pytest

from services.runtime.access.users import create_user
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.orm import Blob, CalibrationRow, StoreFault
from services.runtime.platform import Platform
from services.runtime.store.blobs import keep, link, prepare
from services.runtime.store.faults import comparing, count_of_faults, fault_of, note, note_served, noted_faults
from services.runtime.store.folder import FolderStore
from stone.errors import PlatformFaultError, Refused
from testing.refusals import refused_as
from testing.worlds.decay import decay

CONTENT = b"a recording of the forest\n" * 999


@pytest.fixture
def path(tmp_path: Path) -> Path:
    made = tmp_path / "brought"
    made.write_bytes(CONTENT)
    return made


@pytest.fixture
def blob(anywhere: Platform, path: Path) -> Blob:
    """Store a blob that a calibration names."""
    with anywhere.database.transaction() as session:
        owner = create_user(session, "ada", "curator")
        made = keep(session, anywhere.store, path)
        facts = {"filename": "rig", "sha256": made.sha256, "blob_sha256": made.sha256}
        session.add(CalibrationRow(owner_id=owner.id, name="rig", version=1, sensors=[], findings=[], **facts))
    return made


def put(platform: Platform, blob: Blob, content: bytes, scratch: Path) -> None:
    scratch.write_bytes(content)
    platform.store.write(blob.object_key, scratch)


def with_a_bit_flipped(content: bytes) -> bytes:
    return content[:1000] + bytes([content[1000] ^ 1]) + content[1001:]


@pytest.mark.parametrize("is_small", [True, False])
def test_what_decayed_is_replaced_by_the_same_content_that_comes_again(
    anywhere: Platform, blob: Blob, path: Path, tmp_path: Path, is_small: bool
) -> None:
    put(anywhere, blob, with_a_bit_flipped(CONTENT), tmp_path / "decayed")
    assert fault_of(anywhere.store, blob, is_read=True) == "bytes"
    assert anywhere.store.local(blob.object_key).read_bytes() != CONTENT, "a copy is kept of what decayed"
    with anywhere.database.transaction() as session:
        note(session, blob, "bytes", "scrub")
    if is_small:
        with anywhere.database.transaction() as session:
            keep(session, anywhere.store, path)
    else:
        prepared = prepare(anywhere.store, anywhere.database, path, adopt=True)
        with anywhere.database.transaction() as session:
            link(session, prepared)
    assert b"".join(anywhere.store.read(blob.object_key)) == CONTENT
    assert anywhere.store.local(blob.object_key).read_bytes() == CONTENT
    with anywhere.database.reading() as session:
        assert count_of_faults(session) == 0, "a mended object is still said to be damaged"


def test_a_sound_object_is_not_written_again(
    anywhere: Platform, blob: Blob, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(type(anywhere.store), "write", lambda *_: pytest.fail("written again"))
    prepare(anywhere.store, anywhere.database, path)


def test_a_fault_is_shown_with_what_needs_the_object_until_the_blob_is_gone(anywhere: Platform, blob: Blob) -> None:
    note_served(anywhere.database, [blob.object_key, "blobs/00/nobody"])
    with anywhere.database.transaction() as session:
        (found,) = noted_faults(session)
        assert (found.sha256, found.fault, found.named_by) == (blob.sha256, "served", ("calibrations",))
        session.query(CalibrationRow).delete()
        session.query(Blob).delete()
    with anywhere.database.reading() as session:
        assert noted_faults(session) == []
        assert session.query(StoreFault).count() == 1, "the scrub forgets it"


def test_a_refusal_is_the_platforms_fault_if_what_was_read_differs(
    anywhere: Platform, blob: Blob, tmp_path: Path
) -> None:
    read = ([blob.object_key], "the recording")
    with refused_as("corrupt"), comparing(anywhere.store, anywhere.database, *read):
        raise Refused("corrupt", "it is")
    decay(anywhere, blob.object_key)  # for a bucket: the copy on this machine
    with refused_as("object_damaged"), comparing(anywhere.store, anywhere.database, *read):
        raise Refused("corrupt", "it is")
    with anywhere.database.reading() as session:
        is_in_folder = isinstance(anywhere.store, FolderStore)
        assert [one.fault for one in noted_faults(session)] == ["bytes"] * is_in_folder
    assert (anywhere.store.local(blob.object_key).read_bytes() == CONTENT) != is_in_folder


@pytest.mark.parametrize(
    "error", [PlatformFaultError("store_unavailable", "gone"), JobCancelledError("stop"), OSError(5)]
)
def test_what_is_no_refusal_is_not_compared(anywhere: Platform, blob: Blob, error: Exception) -> None:
    decay(anywhere, blob.object_key)
    with (
        pytest.raises(type(error)) as raised,
        comparing(anywhere.store, anywhere.database, [blob.object_key], "the recording"),
    ):
        raise error
    assert raised.value is error
