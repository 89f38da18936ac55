"""If any system call of an upload fails, the upload is absent, partial or complete; the client can continue it."""

import pytest
from sqlalchemy import select

from services.runtime.access import storage_quota
from services.runtime.orm import Upload
from services.runtime.platform import Platform
from services.runtime.settings import Settings
from services.runtime.uploads import backends
from services.runtime.uploads.backends import backend_of
from services.runtime.uploads.completion import bytes_here, settle_if_whole
from services.runtime.uploads.expiry import expire
from services.runtime.uploads.rows import UploadOwner
from testing.failing_calls import Disturbed, Fault
from testing.servers.fixtures import opened
from tests.chaos.calls.every_call import FAULTS, each_call
from tests.services.runtime.uploads.conftest import with_place
from tests.services.runtime.uploads.sending import made, make_owner, right, send, sha256_of

CONTENT = bytes(range(256)) * 12
FIRST = 1000
KNOWN = ("DiskFullError", "StoreFullError", "OperationalError", "OSError")
"""Errors with which a request may end: the API has a response for each."""


@pytest.fixture(params=["folder", "store"])
def prepared(request: pytest.FixtureRequest, settings: Settings) -> tuple[Settings, UploadOwner]:
    platform = with_place(opened(settings, []), request.param)
    owner = make_owner(platform)
    platform.database.close()
    return platform.settings, owner


def upload_all(platform: Platform, owner: UploadOwner) -> None:
    """Send a file in two requests, the second with a checksum."""
    upload = made(platform, owner, CONTENT, sha256=sha256_of(CONTENT))
    send(platform, upload, 0, CONTENT[:FIRST])
    send(platform, upload, FIRST, CONTENT[FIRST:], right(CONTENT[FIRST:]))


@FAULTS
def test_an_upload_is_absent_partial_or_whole_and_can_be_sent_on(
    prepared: tuple[Settings, UploadOwner], fault: Fault, step: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(backends, "ORPHAN_S", 0.0)
    before, owner = prepared

    def check(platform: Platform, disturbed: Disturbed) -> None:
        assert_sound(platform, owner, disturbed)
        send_on(platform, owner)
        assert_nothing_is_left_over(platform)

    assert each_call(before, lambda platform: upload_all(platform, owner), check, fault, step) > 20


def uploads_in(platform: Platform) -> list[Upload]:
    with platform.database.reading() as session:
        return list(session.scalars(select(Upload)))


def content_of(platform: Platform, upload: Upload) -> bytes:
    with backend_of(platform, upload).local(upload) as path:
        return path.read_bytes()


def assert_sound(platform: Platform, owner: UploadOwner, disturbed: Disturbed) -> None:
    if disturbed.raised:
        assert any(f"{known}: " in disturbed.raised for known in KNOWN), f"at {disturbed.hit}: {disturbed.raised}"
    uploads = uploads_in(platform)
    assert len(uploads) <= 1
    for upload in uploads:
        assert upload.state in ("open", "complete")
        if upload.state == "complete":
            assert content_of(platform, upload) == CONTENT, f"at {disturbed.hit}"
        else:
            assert bytes_here(platform, upload) in range(len(CONTENT) + 1)
    if not disturbed.raised and not disturbed.was_killed:
        assert [upload.state for upload in uploads] == ["complete"], f"said to be here after {disturbed.hit}"
    with platform.database.reading() as session:
        assert storage_quota.balance(session, owner.user_id) == len(CONTENT) * len(uploads), f"at {disturbed.hit}"


def send_on(platform: Platform, owner: UploadOwner) -> None:
    """Read the offset of the upload and send the rest, as a client does."""
    uploads = uploads_in(platform)
    upload = uploads[0] if uploads else made(platform, owner, CONTENT, sha256=sha256_of(CONTENT))
    if upload.state == "open":
        upload = settle_if_whole(platform, upload)
    if upload.state == "open":
        offset = bytes_here(platform, upload)
        send(platform, upload, offset, CONTENT[offset:])
    (upload,) = uploads_in(platform)
    assert (upload.state, upload.sha256) == ("complete", sha256_of(CONTENT))
    assert content_of(platform, upload) == CONTENT


def assert_nothing_is_left_over(platform: Platform) -> None:
    """Assert that the sweeper keeps only the bytes of the upload."""
    expire(platform)
    platform.store.tidy(0.0)
    (upload,) = uploads_in(platform)
    assert content_of(platform, upload) == CONTENT
    folder = platform.settings.uploads_folder
    names = {path.name for path in folder.iterdir()} if folder.is_dir() else set()
    assert names <= {upload.id}, names
