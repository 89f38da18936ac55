"""The state machine of submissions under scoring: every transition happens once.

    draft → queued → scoring → scored | valid | invalid | failed | cancelled

**Conventions.** Each function is part of the caller's transaction and locks, in this order, the run's row (if it reads
it), the submission's and the team's. The run's jobs already hold the run's row when they commit. A stage's result
counts only while the submission is queued or being scored; otherwise the stage is cancelled and its writes are rolled
back.
"""

from collections.abc import Mapping
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.benchmarks.submissions import scoring_quota
from services.domain.benchmarks.submissions.errors import SubmissionStateError
from services.domain.benchmarks.submissions.score_rows import drop_all_parts
from services.runtime.jobs.completion import Failure
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.notifications.events import (
    SUBMISSION_FAILED,
    SUBMISSION_INVALID,
    SUBMISSION_SCORED,
    NewEvent,
    record,
)
from services.runtime.orm import Job, SubmissionRow
from services.runtime.orm.base import now_ns

LIVE = ("queued", "scoring")
OPEN = ("draft", *LIVE)
ENDED = ("scored", "valid", "invalid", "failed", "cancelled")
RETRIED = ("failed", "cancelled")
UP_TO_COUNTING = ("scoring_crashed", "scoring_interrupted", "ground_truth_damaged", "time_limit")
"""Failures that a child counting against the truth can cause."""
TOLD = {"scored": SUBMISSION_SCORED, "invalid": SUBMISSION_INVALID, "failed": SUBMISSION_FAILED}


def lock_submission(session: Session, submission_id: str) -> SubmissionRow:
    """Return the current submission, with its row locked until the end of the transaction."""
    locked = select(SubmissionRow).where(SubmissionRow.id == submission_id).with_for_update(key_share=True)
    return session.scalars(locked.execution_options(populate_existing=True)).one()


def mark_scoring(session: Session, submission_id: str) -> None:
    """Mark the submission as being scored; no effect if it is already being scored or scored.

    Raises `JobCancelledError` if the submission needs no further work.
    """
    submission = lock_submission(session, submission_id)
    if submission.state in ("scoring", "scored"):
        return
    if submission.state != "queued":
        raise JobCancelledError(f"submission {submission_id} is {submission.state}")
    submission.state = "scoring"
    submission.revision += 1
    session.flush()


def settle(
    session: Session,
    submission_id: str,
    state: str,
    problems: Mapping[str, Any] | None = None,
    failure: Failure | None = None,
) -> bool:
    """End a submission and its reserved scoring: used if scored, otherwise released within bounds.

    `problems` is the result of validation (`{"ok", "errors", "errors_total"}`). Returns False if the submission is
    already in this state, for instance scored by an earlier evaluation version. Raises `JobCancelledError` if it ended
    in another state: the result is void and the caller's transaction must be rolled back.
    """
    if state not in ENDED:
        raise ValueError(f"a submission cannot end in state {state!r}")
    submission = lock_submission(session, submission_id)
    if submission.state == state:
        return False
    if submission.state not in LIVE:
        raise JobCancelledError(f"submission {submission_id} is {submission.state}")
    end(session, submission, state, failure)
    if problems is not None:
        submission.problems = dict(problems)
    session.flush()
    return True


def end(session: Session, submission: SubmissionRow, state: str, failure: Failure | None = None) -> None:
    """End a locked submission; use or release its scoring and delete its partial counts."""
    if state == "scored":
        scoring_quota.consume(session, submission.id)
    elif submission.state == "scoring" and (state != "failed" or (failure and failure.code in UP_TO_COUNTING)):
        scoring_quota.release_counted(session, submission.id, state)
    else:
        scoring_quota.release(session, submission.id, f"released: {state}")
    if failure is not None:
        columns = failure.columns()
        submission.failure_code, submission.failure = columns["failure_code"], columns["failure"]
    drop_all_parts(session, submission.id)
    submission.state, submission.settled_ns = state, now_ns()
    submission.revision += 1
    if state in TOLD:
        record(session, NewEvent(TOLD[state], submission.id, team_id=submission.team_id))


def reopen(session: Session, run: Job) -> None:
    """Queue the submission of a retried run; its scoring is retaken regardless of the limit.

    The run's row is locked. Raises `SubmissionStateError` if the submission's file was deleted.
    """
    of_run = select(SubmissionRow.id).where(SubmissionRow.job_id == run.id, SubmissionRow.state.in_(RETRIED))
    for submission_id in session.scalars(of_run).all():
        submission = lock_submission(session, submission_id)
        if submission.upload_id is None:
            raise SubmissionStateError(submission_id, "without its file, which was deleted,", "scored again", "kept")
        scoring_quota.retake(session, submission_id)
        submission.state, submission.settled_ns = "queued", None
        submission.failure_code = submission.failure = ""
        submission.revision += 1
        session.flush()
