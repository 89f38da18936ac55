"""Sweeper chores of submissions: settle orphaned submissions, delete files, delete stale drafts.

**Conventions.** Any number of sweepers may run: each change is one transaction that checks again under its locks. A
file counts against its submitter until the transaction that deletes it. The submission then refers to no upload and no
blob, so the bytes are collected.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import structlog
from sqlalchemy import ColumnElement, and_, delete, exists, or_, select, text, tuple_

from services.domain.benchmarks.submissions.state_machine import LIVE, end, lock_submission
from services.runtime.access import storage_quota
from services.runtime.jobs.changes import lock_run, rows_changed
from services.runtime.jobs.completion import Failure
from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import Job, SubmissionRow, Upload
from services.runtime.orm.base import now_ns
from services.runtime.orm.submissions import IS_UNSCORED
from services.runtime.platform import Platform
from services.runtime.uploads.rows import is_waiting

AT_A_TIME = 200
UNSAID = Failure("internal_error", "a fault of the platform ended it; the quota was restored, please submit again")
UNSETTLED = Failure("unsettled", "its jobs ended without a result; the quota was restored, please submit again")

log = structlog.get_logger(__name__)


def settle_ended(platform: Platform) -> int:
    """End submissions whose run ended without settling them, with the run's reason; return their number.

    A run ends without its submission if its worker was lost too often, a stage refused, a time limit was reached, or
    the job itself was stopped. The reserved scoring is released.
    """
    state = select(Job.state).where(Job.id == SubmissionRow.job_id).scalar_subquery()  # a join starts from all jobs
    ended = select(SubmissionRow.id, SubmissionRow.job_id).where(SubmissionRow.state.in_(LIVE), state.in_(TERMINAL))
    ended = ended.order_by(SubmissionRow.id).limit(AT_A_TIME)
    with platform.database.reading() as session:
        rows = session.execute(ended).all()
    return sum(_settle(platform, submission_id, job_id) for submission_id, job_id in rows if job_id)


@dataclass
class DraftWalk:
    """The position among old drafts, by age; drafts with a pending upload are skipped."""

    after: tuple[int, str] = (0, "")


def tidy_submissions(platform: Platform, drafts: DraftWalk | None = None) -> tuple[int, int]:
    """Delete expired files and abandoned drafts, a limited number per turn; return the two numbers."""
    settings = platform.settings.submissions
    now = now_ns()
    purged = sum(
        _purge(platform, submission_id, now - int(settings.purged_after_s * 1e9))
        for submission_id in _purgeable(platform, now - int(settings.purged_after_s * 1e9))
    )
    return purged, _remove_drafts(platform, now - int(settings.draft_s * 1e9), drafts or DraftWalk())


def _settle(platform: Platform, submission_id: str, job_id: str) -> bool:
    with platform.database.transaction() as session:
        run = lock_run(session, job_id)
        submission = lock_submission(session, submission_id)
        if submission.state not in LIVE or run.state not in TERMINAL:  # settled or retried meanwhile
            return False
        failure = _failure_of(run)
        end(session, submission, "cancelled" if run.state == "cancelled" else "failed", failure)
    log.warning("submission ended by its run", submission_id=submission_id, job_id=job_id, code=failure.code)
    return True


def _failure_of(run: Job) -> Failure:
    """Return the failure to show to the team; errors raised inside a stage are described only in the job."""
    if run.state == "succeeded":
        return UNSETTLED
    if run.state == "cancelled":
        return Failure("cancelled", f"cancelled: {run.cancel_reason}")
    return UNSAID if run.failure_code in ("", UNSAID.code) else Failure(run.failure_code, run.failure)


def _purgeable_before(before_ns: int) -> tuple[ColumnElement[bool], ColumnElement[bool]]:
    """Return the conditions for expired unscored files and for expired withdrawn files.

    Scored files are kept for re-scores. Each condition uses the literals of its partial index, so files deleted earlier
    are not scanned again.
    """
    is_kept = SubmissionRow.upload_id.is_not(None)
    is_unscored = and_(is_kept, text(IS_UNSCORED), SubmissionRow.settled_ns <= before_ns)
    is_withdrawn = and_(is_kept, SubmissionRow.state == "scored", SubmissionRow.withdrawn_ns <= before_ns)
    return is_unscored, is_withdrawn


def _purgeable(platform: Platform, before_ns: int) -> Sequence[str]:
    submission_ids: list[str] = []
    with platform.database.reading() as session:
        for is_purgeable in _purgeable_before(before_ns):
            submission_ids += session.scalars(select(SubmissionRow.id).where(is_purgeable).limit(AT_A_TIME))
    return submission_ids


def _purge(platform: Platform, submission_id: str, before_ns: int) -> bool:
    with platform.database.transaction() as session:
        submission = lock_submission(session, submission_id)
        due = select(SubmissionRow.id).where(SubmissionRow.id == submission_id, or_(*_purgeable_before(before_ns)))
        if session.scalar(due) is None:  # another sweeper was first, or the run is retried
            return False
        storage_quota.release(session, submission.upload_id or "", "submission purged")
        submission.upload_id = submission.blob_sha256 = None
        submission.revision += 1
    return True


def _remove_drafts(platform: Platform, before_ns: int, walk: DraftWalk) -> int:
    """Delete old drafts without a pending upload.

    The drafts are locked before their uploads are checked, because creating an upload takes the same lock.
    """
    position = (SubmissionRow.created_ns, SubmissionRow.id)
    old = select(*position).where(
        SubmissionRow.state == "draft", SubmissionRow.created_ns <= before_ns, tuple_(*position) > walk.after
    )
    with platform.database.reading() as session:
        drafts = [
            (age, submission_id) for age, submission_id in session.execute(old.order_by(*position).limit(AT_A_TIME))
        ]
    walk.after = drafts[-1] if len(drafts) == AT_A_TIME else (0, "")
    are_found = SubmissionRow.id.in_([submission_id for _, submission_id in drafts])
    is_awaited = exists().where(Upload.purpose == "submission", is_waiting(), Upload.target_id == SubmissionRow.id)
    forgotten = delete(SubmissionRow).where(are_found, SubmissionRow.state == "draft", ~is_awaited)
    with platform.database.transaction() as session:
        session.execute(select(SubmissionRow.id).where(are_found).order_by(SubmissionRow.id).with_for_update())
        return rows_changed(session, forgotten)
