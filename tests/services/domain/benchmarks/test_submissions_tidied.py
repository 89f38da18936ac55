"""Files of submissions go when their time is over and count against their sender until then; so do old drafts."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from services.domain.benchmarks.submissions import chores
from services.domain.benchmarks.submissions.chores import DraftWalk, tidy_submissions
from services.domain.benchmarks.submissions.submissions import cancel
from services.runtime.access import storage_quota
from services.runtime.orm import Blob, SubmissionRow
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.settings import StoreSettings, SubmissionSettings
from services.runtime.store import blobs
from services.runtime.store.garbage_collection import collect_garbage
from services.runtime.uploads import expire, upload_file
from services.runtime.uploads.creation import create
from services.runtime.uploads.declaration import UploadDeclaration
from services.runtime.uploads.rows import UploadOwner
from tests.services.domain.benchmarks.drafts import ZIP, Entrant, drafted, entrant_on, finalised, seen, uploaded

LONG_AGO_NS = 31 * 86_400 * 10**9


def sent(entrant: Entrant, **columns: Any) -> str:
    """The id of a finalised submission whose upload counts against its sender; then `columns` of its row."""
    submission_id = drafted(entrant)
    upload_id = uploaded(entrant, submission_id)
    with entrant.platform.database.transaction() as session:
        storage_quota.reserve(session, entrant.captain.user_id, len(ZIP), upload_id, "upload", 10**6)
    finalised(entrant, submission_id, upload_id)
    with entrant.platform.database.transaction() as session:
        row = session.get_one(SubmissionRow, submission_id)
        for name, value in columns.items():
            setattr(row, name, value)
    return submission_id


def kept(entrant: Entrant, submission_id: str) -> None:
    """Its file as a blob, as the first stage keeps it."""
    path = file_of(entrant, submission_id)
    with entrant.platform.database.transaction() as session:
        blob = blobs.keep(session, entrant.platform.store, path, adopt=True)
        session.get_one(SubmissionRow, submission_id).blob_sha256 = blob.sha256


def file_of(entrant: Entrant, submission_id: str) -> Path:
    return upload_file(entrant.platform.settings, seen(entrant, submission_id).upload_id or "")


def counted_bytes(entrant: Entrant) -> int:
    with entrant.platform.database.reading() as session:
        return storage_quota.balance(session, entrant.captain.user_id)


def long_ago() -> int:
    return now_ns() - LONG_AGO_NS


@pytest.mark.parametrize("state", ["invalid", "failed", "cancelled", "valid"])
def test_a_file_that_no_score_stands_on_is_purged_after_its_time(platform: Platform, state: str) -> None:
    entrant = entrant_on(platform)
    submission_id = sent(entrant, state=state, settled_ns=long_ago())
    assert tidy_submissions(platform) == (1, 0)
    row = seen(entrant, submission_id)
    assert (row.state, row.upload_id, row.blob_sha256) == (state, None, None)
    assert counted_bytes(entrant) == 0
    assert tidy_submissions(platform) == (0, 0)


@pytest.mark.parametrize(
    ("state", "age_ns"), [("scored", LONG_AGO_NS), ("scoring", LONG_AGO_NS), ("queued", LONG_AGO_NS), ("invalid", 0)]
)
def test_other_files_stay_and_stay_counted(platform: Platform, state: str, age_ns: int) -> None:
    entrant = entrant_on(platform)
    submission_id = sent(entrant, state=state, settled_ns=now_ns() - age_ns)
    assert tidy_submissions(platform) == (0, 0)
    assert seen(entrant, submission_id).upload_id is not None
    assert counted_bytes(entrant) == len(ZIP)


def test_a_withdrawn_entry_keeps_its_file_for_as_long_as_a_failed_one(platform: Platform) -> None:
    entrant = entrant_on(platform)
    submission_id = sent(entrant, state="scored", settled_ns=long_ago(), withdrawn_ns=now_ns())
    assert tidy_submissions(platform) == (0, 0)
    with platform.database.transaction() as session:
        session.get_one(SubmissionRow, submission_id).withdrawn_ns = long_ago()
    assert tidy_submissions(platform) == (1, 0)
    assert counted_bytes(entrant) == 0


def test_the_bytes_on_disk_go_with_the_file_once_and_for_all(platform: Platform) -> None:
    """In the uploads folder until the store has them, in the store until they are purged, then nowhere."""
    entrant = entrant_on(platform)
    submission_id = sent(entrant)
    path = file_of(entrant, submission_id)
    expire(platform)
    assert path.read_bytes() == ZIP
    kept(entrant, submission_id)
    expire(platform)
    assert not path.exists()
    assert counted_bytes(entrant) == len(ZIP)
    sha256 = seen(entrant, submission_id).blob_sha256
    with platform.database.transaction() as session:
        row = session.get_one(SubmissionRow, submission_id)
        row.state, row.settled_ns = "failed", long_ago()
        object_key = session.get_one(Blob, sha256).object_key
    tidy_submissions(platform)
    without_grace = replace(platform, settings=platform.settings.model_copy(update={"store": StoreSettings(grace_s=0)}))
    collect_garbage(without_grace)
    with platform.database.reading() as session:
        assert session.get(Blob, sha256) is None
    assert not (platform.settings.root / "store" / object_key).exists()
    assert counted_bytes(entrant) == 0


def test_a_file_that_was_never_kept_goes_from_the_uploads_folder(platform: Platform) -> None:
    entrant = entrant_on(platform)
    submission_id = sent(entrant, state="failed", settled_ns=long_ago())
    path = file_of(entrant, submission_id)
    expire(platform)
    assert path.exists()
    tidy_submissions(platform)
    expire(platform)
    assert not path.exists()


def test_a_draft_that_nothing_is_sent_for_goes_after_its_time(platform: Platform) -> None:
    entrant = entrant_on(platform)
    old = [drafted(entrant) for _ in range(3)]
    fresh, finished = drafted(entrant), sent(entrant)
    uploaded(entrant, old[0])
    uploaded(entrant, old[1], state="expired")
    with platform.database.transaction() as session:
        for submission_id in (*old, finished):
            session.get_one(SubmissionRow, submission_id).created_ns = long_ago()
    assert tidy_submissions(platform) == (0, 2)
    with platform.database.reading() as session:
        left = {row.id for row in session.query(SubmissionRow)}
    assert left == {old[0], fresh, finished}


def test_drafts_that_are_awaited_hold_up_none_behind_them(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chores, "AT_A_TIME", 1)
    entrant, walk = entrant_on(platform), DraftWalk()
    awaited, forgotten = drafted(entrant), drafted(entrant)
    uploaded(entrant, awaited)
    with platform.database.transaction() as session:
        for age_ns, submission_id in enumerate((awaited, forgotten), start=1):
            session.get_one(SubmissionRow, submission_id).created_ns = age_ns
    assert [tidy_submissions(platform, walk) for _ in range(3)] == [(0, 0), (0, 1), (0, 0)]
    assert seen(entrant, awaited).state == "draft"


def test_the_times_are_those_of_the_settings(platform: Platform) -> None:
    entrant = entrant_on(platform)
    sent(entrant, state="invalid", settled_ns=now_ns() - 10**9)
    drafted(entrant)
    hasty = platform.settings.model_copy(update={"submissions": SubmissionSettings(draft_s=0.0, purged_after_s=0.5)})
    assert tidy_submissions(replace(platform, settings=hasty)) == (1, 1)


def test_what_is_on_its_way_for_a_cancelled_draft_is_freed(platform: Platform) -> None:
    entrant = entrant_on(platform)
    submission_id = drafted(entrant)
    said = {"target_id": submission_id, "sha256": seen(entrant, submission_id).declared_sha256}
    owner = UploadOwner(entrant.captain.user_id, is_participant=True)
    upload = create(platform, owner, UploadDeclaration("run.zip", "submission", len(ZIP), **said))
    assert counted_bytes(entrant) == len(ZIP)
    with platform.database.transaction() as session:
        cancel(session, session.get_one(SubmissionRow, submission_id))
    assert expire(platform) == 1
    assert counted_bytes(entrant) == 0
    assert not upload_file(platform.settings, upload.id).exists()
