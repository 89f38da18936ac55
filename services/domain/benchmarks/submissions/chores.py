"""Sweeper chores of submissions: settle orphaned ones, purge files, delete stale drafts.

**Conventions.** Any number of sweepers may run: each change is one transaction that looks again under its locks. A file
counts against its submitter until it is purged, in the same transaction; a purged submission names no upload and no
blob, so that its bytes are collected.
"""

from collections.abc import Sequence

import structlog
from sqlalchemy import ColumnElement, and_, delete, exists, or_, select

from services.domain.benchmarks.submissions.states import LIVE, end, lock_submission
from services.runtime.access import storage_quota
from services.runtime.jobs.changes import lock_run
from services.runtime.jobs.completion import Failure
from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import Job, SubmissionRow, Upload
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform

AT_A_TIME = 200
UNSCORED = ("valid", "invalid", "failed", "cancelled")
UNSAID = Failure("internal_error", "a fault of the platform ended it; the scoring was given back, please submit again")
UNSETTLED = Failure("unsettled", "its jobs ended without a verdict; the scoring was given back, please submit again")

log = structlog.get_logger(__name__)


def settle_ended(platform: Platform) -> int:
    """Let submissions end whose run has ended without settling them, with the run's reason; how many there were.

    A run fails or is cancelled without its submission when its worker was lost too often, a stage refused or a time
    limit was reached, or somebody stopped the job itself. What was reserved is given back.
    """
    ended = select(SubmissionRow.id, SubmissionRow.job_id).join(Job, Job.id == SubmissionRow.job_id)
    ended = (
        ended.where(SubmissionRow.state.in_(LIVE), Job.state.in_(TERMINAL)).order_by(SubmissionRow.id).limit(AT_A_TIME)
    )
    with platform.database.reading() as session:
        found = session.execute(ended).all()
    return sum(_settle(platform, submission_id, job_id) for submission_id, job_id in found if job_id)


def tidy_submissions(platform: Platform) -> tuple[int, int]:
    """Purge files after their time and remove drafts that nothing was sent for; how many of each."""
    settings = platform.settings.submissions
    now = now_ns()
    purged = sum(
        _purge(platform, submission_id, now - int(settings.purged_after_s * 1e9))
        for submission_id in _purgeable(platform, now - int(settings.purged_after_s * 1e9))
    )
    return purged, _remove_drafts(platform, now - int(settings.draft_s * 1e9))


def _settle(platform: Platform, submission_id: str, job_id: str) -> bool:
    with platform.database.transaction() as session:
        run = lock_run(session, job_id)
        submission = lock_submission(session, submission_id)
        if submission.state not in LIVE or run.state not in TERMINAL:  # settled, or tried again, meanwhile
            return False
        failure = _failure_of(run)
        end(session, submission, "cancelled" if run.state == "cancelled" else "failed", failure)
    log.warning("submission ended by its run", submission_id=submission_id, job_id=job_id, code=failure.code)
    return True


def _failure_of(run: Job) -> Failure:
    """The reason of the failure for the team: of what raised inside of a stage only the job keeps the words."""
    if run.state == "succeeded":
        return UNSETTLED
    if run.state == "cancelled":
        return Failure("cancelled", f"cancelled: {run.cancel_reason}")
    return UNSAID if run.failure_code in ("", UNSAID.code) else Failure(run.failure_code, run.failure)


def _is_purgeable(before_ns: int) -> ColumnElement[bool]:
    """Whether a file is kept that no score stands on, and its time is over. Scored ones are kept for re-scores."""
    is_unscored = and_(SubmissionRow.state.in_(UNSCORED), SubmissionRow.settled_ns <= before_ns)
    is_withdrawn = and_(SubmissionRow.state == "scored", SubmissionRow.withdrawn_ns <= before_ns)
    return and_(SubmissionRow.upload_id.is_not(None), or_(is_unscored, is_withdrawn))


def _purgeable(platform: Platform, before_ns: int) -> Sequence[str]:
    found = select(SubmissionRow.id).where(_is_purgeable(before_ns)).order_by(SubmissionRow.id).limit(AT_A_TIME)
    with platform.database.reading() as session:
        return session.scalars(found).all()


def _purge(platform: Platform, submission_id: str, before_ns: int) -> bool:
    with platform.database.transaction() as session:
        submission = lock_submission(session, submission_id)
        due = select(SubmissionRow.id).where(SubmissionRow.id == submission_id, _is_purgeable(before_ns))
        if session.scalar(due) is None:  # another sweeper was first, or its run is tried again
            return False
        storage_quota.release(session, submission.upload_id or "", "submission purged")
        submission.upload_id = submission.blob_sha256 = None
        submission.revision += 1
    return True


def _remove_drafts(platform: Platform, before_ns: int) -> int:
    """Drafts of old that have no upload on its way."""
    waiting = and_(Upload.purpose == "submission", Upload.state.in_(("open", "complete")))
    is_awaited = exists().where(waiting, Upload.target_id == SubmissionRow.id)
    forgotten = delete(SubmissionRow).where(
        SubmissionRow.state == "draft", SubmissionRow.created_ns <= before_ns, ~is_awaited
    )
    gone = forgotten.returning(SubmissionRow.id).execution_options(synchronize_session=False)
    with platform.database.transaction() as session:
        return len(session.scalars(gone).all())
