"""Files of submissions go when their time is over and count against their sender until then; so do old drafts."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from services.runtime import blobs, quota
from services.runtime.benchmarks.submission_chores import tidy_submissions
from services.runtime.benchmarks.submissions import cancel
from services.runtime.collection import collect
from services.runtime.orm import Blob, Submission
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.settings import StoreSettings, SubmissionSettings
from services.runtime.uploads import expire, upload_file
from services.runtime.uploads.creating import create
from services.runtime.uploads.declared import Declared
from services.runtime.uploads.rows import Owner
from tests.services.runtime.benchmarks.drafts import ZIP, Desk, desk_on, drafted, finalised, seen, uploaded

LONG_AGO_NS = 31 * 86_400 * 10**9


def sent(desk: Desk, **columns: Any) -> str:
    """The id of a finalised submission whose upload counts against its sender; then `columns` of its row."""
    submission_id = drafted(desk)
    upload_id = uploaded(desk, submission_id)
    with desk.platform.database.transaction() as session:
        quota.reserve(session, desk.captain.user_id, len(ZIP), upload_id, "upload", 10**6)
    finalised(desk, submission_id, upload_id)
    with desk.platform.database.transaction() as session:
        row = session.get_one(Submission, submission_id)
        for name, value in columns.items():
            setattr(row, name, value)
    return submission_id


def kept(desk: Desk, submission_id: str) -> None:
    """Its file as a blob, as the first stage keeps it."""
    path = file_of(desk, submission_id)
    with desk.platform.database.transaction() as session:
        blob = blobs.keep(session, desk.platform.store, path, adopt=True)
        session.get_one(Submission, submission_id).blob_sha256 = blob.sha256


def file_of(desk: Desk, submission_id: str) -> Path:
    return upload_file(desk.platform.settings, seen(desk, submission_id).upload_id or "")


def counted_bytes(desk: Desk) -> int:
    with desk.platform.database.reading() as session:
        return quota.balance(session, desk.captain.user_id)


def long_ago() -> int:
    return now_ns() - LONG_AGO_NS


@pytest.mark.parametrize("state", ["invalid", "failed", "cancelled", "valid"])
def test_a_file_that_no_score_stands_on_is_purged_after_its_time(platform_on: Platform, state: str) -> None:
    desk = desk_on(platform_on)
    submission_id = sent(desk, state=state, settled_ns=long_ago())
    assert tidy_submissions(platform_on) == (1, 0)
    row = seen(desk, submission_id)
    assert (row.state, row.upload_id, row.blob_sha256) == (state, None, None)
    assert counted_bytes(desk) == 0
    assert tidy_submissions(platform_on) == (0, 0)


@pytest.mark.parametrize(
    ("state", "age_ns"), [("scored", LONG_AGO_NS), ("scoring", LONG_AGO_NS), ("queued", LONG_AGO_NS), ("invalid", 0)]
)
def test_other_files_stay_and_stay_counted(platform: Platform, state: str, age_ns: int) -> None:
    desk = desk_on(platform)
    submission_id = sent(desk, state=state, settled_ns=now_ns() - age_ns)
    assert tidy_submissions(platform) == (0, 0)
    assert seen(desk, submission_id).upload_id is not None
    assert counted_bytes(desk) == len(ZIP)


def test_a_withdrawn_entry_keeps_its_file_for_as_long_as_a_failed_one(platform: Platform) -> None:
    desk = desk_on(platform)
    submission_id = sent(desk, state="scored", settled_ns=long_ago(), withdrawn_ns=now_ns())
    assert tidy_submissions(platform) == (0, 0)
    with platform.database.transaction() as session:
        session.get_one(Submission, submission_id).withdrawn_ns = long_ago()
    assert tidy_submissions(platform) == (1, 0)
    assert counted_bytes(desk) == 0


def test_the_bytes_on_disk_go_with_the_file_once_and_for_all(platform: Platform) -> None:
    """In the uploads folder until the store has them, in the store until they are purged, then nowhere."""
    desk = desk_on(platform)
    submission_id = sent(desk)
    path = file_of(desk, submission_id)
    expire(platform)
    assert path.read_bytes() == ZIP
    kept(desk, submission_id)
    expire(platform)
    assert not path.exists()
    assert counted_bytes(desk) == len(ZIP)
    sha256 = seen(desk, submission_id).blob_sha256
    with platform.database.transaction() as session:
        row = session.get_one(Submission, submission_id)
        row.state, row.settled_ns = "failed", long_ago()
        object_key = session.get_one(Blob, sha256).object_key
    tidy_submissions(platform)
    without_grace = replace(platform, settings=platform.settings.model_copy(update={"store": StoreSettings(grace_s=0)}))
    collect(without_grace)
    with platform.database.reading() as session:
        assert session.get(Blob, sha256) is None
    assert not (platform.settings.root / "store" / object_key).exists()
    assert counted_bytes(desk) == 0


def test_a_file_that_was_never_kept_goes_from_the_uploads_folder(platform: Platform) -> None:
    desk = desk_on(platform)
    submission_id = sent(desk, state="failed", settled_ns=long_ago())
    path = file_of(desk, submission_id)
    expire(platform)
    assert path.exists()
    tidy_submissions(platform)
    expire(platform)
    assert not path.exists()


def test_a_draft_that_nothing_is_sent_for_goes_after_its_time(platform_on: Platform) -> None:
    desk = desk_on(platform_on)
    old = [drafted(desk) for _ in range(3)]
    fresh, finished = drafted(desk), sent(desk)
    uploaded(desk, old[0])
    uploaded(desk, old[1], state="expired")
    with platform_on.database.transaction() as session:
        for submission_id in (*old, finished):
            session.get_one(Submission, submission_id).created_ns = long_ago()
    assert tidy_submissions(platform_on) == (0, 2)
    with platform_on.database.reading() as session:
        left = {row.id for row in session.query(Submission)}
    assert left == {old[0], fresh, finished}


def test_the_times_are_those_of_the_settings(platform: Platform) -> None:
    desk = desk_on(platform)
    sent(desk, state="invalid", settled_ns=now_ns() - 10**9)
    drafted(desk)
    hasty = platform.settings.model_copy(update={"submissions": SubmissionSettings(draft_s=0.0, purged_after_s=0.5)})
    assert tidy_submissions(replace(platform, settings=hasty)) == (1, 1)


def test_what_is_on_its_way_for_a_cancelled_draft_is_freed(platform: Platform) -> None:
    desk = desk_on(platform)
    submission_id = drafted(desk)
    said = {"target_id": submission_id, "sha256": seen(desk, submission_id).declared_sha256}
    owner = Owner(desk.captain.user_id, is_participant=True)
    upload = create(platform, owner, Declared("run.zip", "submission", len(ZIP), **said))
    assert counted_bytes(desk) == len(ZIP)
    with platform.database.transaction() as session:
        cancel(session, session.get_one(Submission, submission_id))
    assert expire(platform) == 1
    assert counted_bytes(desk) == 0
    assert not upload_file(platform.settings, upload.id).exists()
