"""A submission is sent to be scored whole or not at all, only what was announced, and its file goes in its time."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from services.domain.benchmarks.submissions import scoring_quota, sweeper_chores
from services.domain.benchmarks.submissions.errors import (
    ExhaustedError,
    SubmissionStateError,
)
from services.domain.benchmarks.submissions.scoring_jobs import OPEN
from services.domain.benchmarks.submissions.submissions import MOST_OPEN, cancel, largest_bytes
from services.domain.benchmarks.submissions.sweeper_chores import DraftWalk, tidy_submissions
from services.runtime.access import storage_quota
from services.runtime.jobs.control import set_mode
from services.runtime.jobs.errors import QueueDrainingError
from services.runtime.orm import Activation, Blob, Job, Phase, PhaseTeam, SubmissionRow, TeamMember, Upload
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.settings import StoreSettings
from services.runtime.store import blobs
from services.runtime.store.garbage_collection import collect_garbage
from services.runtime.uploads import expire, upload_file
from services.runtime.uploads.creation import UploadDeclaration, create
from services.runtime.uploads.rows import UploadOwner
from testing.refusals import refused_as
from testing.servers.fixtures import Bells
from testing.worlds.made import NOBODY
from tests.services.domain.benchmarks.drafts import (
    ZIP,
    Entrant,
    another_entrant,
    drafted,
    entrant_on,
    finalised,
    seen,
    taken,
    uploaded,
)

HOUR_NS = 3600 * 10**9
DAY_NS = 24 * HOUR_NS


def upload_state(entrant: Entrant, upload_id: str) -> str:
    with entrant.platform.database.reading() as session:
        return session.get_one(Upload, upload_id).state


def assert_untouched(entrant: Entrant, submission_id: str, upload_id: str) -> None:
    """A draft and its upload are as they were, and nothing was taken or queued."""
    row = seen(entrant, submission_id)
    assert (row.state, row.upload_id, row.job_id, row.finalized_ns) == ("draft", None, None, None)
    assert upload_state(entrant, upload_id) == "complete"
    with entrant.platform.database.reading() as session:
        assert session.query(Job).filter_by(kind=OPEN).count() == session.query(PhaseTeam).count() == 0


def test_a_phase_that_is_not_open_takes_no_draft(platform: Platform) -> None:
    for rules in ({"opens_ns": now_ns() + DAY_NS}, {"closes_ns": now_ns() - DAY_NS}):
        with refused_as("phase_closed"):
            drafted(entrant_on(platform, **rules))


def test_a_phase_that_closed_meanwhile_takes_no_file(platform: Platform) -> None:
    entrant = entrant_on(platform)
    submission_id = drafted(entrant)
    upload_id = uploaded(entrant, submission_id)
    with platform.database.transaction() as session:
        session.get_one(Phase, entrant.phase_id).closes_ns = now_ns()
    with refused_as("phase_closed"):
        finalised(entrant, submission_id, upload_id)
    assert_untouched(entrant, submission_id, upload_id)


def test_a_phase_without_a_ground_truth_takes_no_draft(platform: Platform) -> None:
    entrant = entrant_on(platform)
    with platform.database.transaction() as session:
        session.query(Activation).delete()
    with refused_as("no_ground_truth"):
        drafted(entrant)


def test_a_file_larger_than_its_frames_is_refused_before_it_is_sent(platform: Platform) -> None:
    entrant = entrant_on(platform)
    limit_bytes = largest_bytes(2000)
    assert seen(entrant, drafted(entrant, size_bytes=limit_bytes)).size_bytes == limit_bytes
    with refused_as("submission_too_large", match=f"{limit_bytes + 1} bytes, but 2000 frames"):
        drafted(entrant, size_bytes=limit_bytes + 1)


def test_a_team_has_a_bounded_number_of_open_submissions(platform: Platform) -> None:
    entrant = entrant_on(platform)
    drafts = [drafted(entrant) for _ in range(MOST_OPEN)]
    with refused_as("too_many_open"):
        drafted(entrant)
    drafted(another_entrant(entrant.place))
    with platform.database.transaction() as session:
        cancel(session, session.get_one(SubmissionRow, drafts[0]))
    drafted(entrant)


def test_an_entry_takes_its_upload_a_scoring_and_a_place_in_the_queue(platform: Platform, bells: Bells) -> None:
    entrant = entrant_on(platform)
    submission_id = drafted(entrant)
    upload_id = uploaded(entrant, submission_id)
    finalised(entrant, submission_id, upload_id)
    row = seen(entrant, submission_id)
    assert (row.state, row.upload_id, row.revision) == ("queued", upload_id, 2)
    assert (upload_state(entrant, upload_id), taken(entrant)) == ("consumed", 1)
    with platform.database.reading() as session:
        bound = session.query(PhaseTeam).one()
        job = session.query(Job).filter_by(kind=OPEN).one()
        run = session.get_one(Job, job.root_id)
    assert (bound.user_id, bound.team_id) == (entrant.captain.user_id, entrant.team_id)
    assert job.arguments == {"submission_id": submission_id}
    assert (run.id, run.owner_id) == (row.job_id, entrant.captain.user_id)
    assert bells == [("eval", 1)]


@pytest.mark.parametrize("kind", ["validation", "baseline"])
def test_what_is_not_an_entry_costs_no_scoring(platform: Platform, kind: str) -> None:
    entrant = entrant_on(platform, scorings_total=0)
    finalised(entrant, kind=kind)
    assert taken(entrant) == 0


def test_a_baseline_costs_a_scoring_where_the_truth_is_hidden(platform: Platform) -> None:
    """The attack: as many looks at a hidden truth as a curator likes, by calling each a baseline."""
    entrant = entrant_on(platform, is_hidden=True, scorings_per_window=2)
    finalised(entrant, kind="baseline")
    finalised(entrant, kind="validation")
    finalised(entrant, kind="entry")
    assert taken(entrant) == 2
    with refused_as("scorings_exhausted"):
        finalised(entrant, kind="baseline")
    assert taken(entrant) == 2


def test_a_quota_that_is_used_up_leaves_draft_and_upload_for_later(platform: Platform) -> None:
    entrant = entrant_on(platform, scorings_per_window=0)
    submission_id = drafted(entrant)
    upload_id = uploaded(entrant, submission_id)
    with refused_as("scorings_exhausted"):
        finalised(entrant, submission_id, upload_id)
    assert_untouched(entrant, submission_id, upload_id)
    with platform.database.transaction() as session:
        scoring_quota.grant(session, session.get_one(Phase, entrant.phase_id), entrant.team_id, 1)
    finalised(entrant, submission_id, upload_id)


def test_a_draining_queue_takes_nothing(platform: Platform) -> None:
    entrant = entrant_on(platform)
    submission_id = drafted(entrant)
    upload_id = uploaded(entrant, submission_id)
    with platform.database.transaction() as session:
        set_mode(session, "eval", "draining")
    with pytest.raises(QueueDrainingError):
        finalised(entrant, submission_id, upload_id)
    assert_untouched(entrant, submission_id, upload_id)
    assert taken(entrant) == 0


def test_who_takes_part_with_another_team_cannot_submit_with_this_one(platform: Platform) -> None:
    entrant = entrant_on(platform)
    other = another_entrant(entrant.place)
    finalised(other)
    with platform.database.transaction() as session:
        session.add(TeamMember(team_id=entrant.team_id, user_id=other.captain.user_id))
    submission_id = drafted(entrant)
    with refused_as("already_in_team"):
        finalised(entrant, submission_id)
    with refused_as("already_in_team"):  # the one who is bound is told so before anything is sent
        drafted(entrant, user_id=other.captain.user_id)
    assert (seen(entrant, submission_id).state, taken(entrant)) == ("draft", 0)


def test_a_submission_is_finalised_once(platform: Platform) -> None:
    entrant = entrant_on(platform)
    submission_id = drafted(entrant)
    first, second = uploaded(entrant, submission_id), uploaded(entrant, submission_id)
    finalised(entrant, submission_id, first)
    with pytest.raises(SubmissionStateError):
        finalised(entrant, submission_id, second)
    assert taken(entrant) == 1
    with platform.database.reading() as session:
        assert session.get_one(Upload, second).expires_ns <= now_ns()


@pytest.mark.parametrize(
    ("columns", "refusal"),
    [
        ({"state": "open"}, "wrong_upload_state"),
        ({"purpose": "recording"}, "wrong_upload_purpose"),
        ({"target_id": NOBODY}, "upload_missing"),
        ({"sha256": "1" * 64}, "hash_mismatch"),
        ({"length_bytes": len(ZIP) + 1}, "hash_mismatch"),
    ],
)
def test_only_the_announced_file_is_taken(platform: Platform, columns: dict[str, Any], refusal: str) -> None:
    entrant = entrant_on(platform)
    submission_id = drafted(entrant)
    upload_id = uploaded(entrant, submission_id, **columns)
    with refused_as(refusal):
        finalised(entrant, submission_id, upload_id)
    assert upload_state(entrant, upload_id) == columns.get("state", "complete")
    assert (seen(entrant, submission_id).state, taken(entrant)) == ("draft", 0)


def test_validations_are_counted_by_the_day(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    entrant = entrant_on(platform, validations_per_day=2)
    waiting = drafted(entrant, kind="validation")
    finalised(entrant, kind="validation")
    failed = finalised(entrant, kind="validation")
    with platform.database.transaction() as session:
        session.get_one(SubmissionRow, failed).state = "failed"
    finalised(entrant, waiting)
    with pytest.raises(ExhaustedError) as refused:
        drafted(entrant, kind="validation")
    next_ns = refused.value.next_ns
    assert refused.value.code == "validations_exhausted"
    assert next_ns is not None
    assert next_ns > now_ns() + DAY_NS - HOUR_NS
    finalised(entrant)
    monkeypatch.setattr("services.domain.benchmarks.submissions.submissions.now_ns", lambda: next_ns)
    drafted(entrant, kind="validation")


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
    monkeypatch.setattr(sweeper_chores, "AT_A_TIME", 1)
    entrant, walk = entrant_on(platform), DraftWalk()
    awaited, forgotten = drafted(entrant), drafted(entrant)
    uploaded(entrant, awaited)
    with platform.database.transaction() as session:
        for age_ns, submission_id in enumerate((awaited, forgotten), start=1):
            session.get_one(SubmissionRow, submission_id).created_ns = age_ns
    assert [tidy_submissions(platform, walk) for _ in range(3)] == [(0, 0), (0, 1), (0, 0)]
    assert seen(entrant, awaited).state == "draft"


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
