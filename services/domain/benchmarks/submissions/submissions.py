"""Submissions: created, finalized, cancelled, withdrawn, hidden, described.

**Conventions.** Each function is part of the caller's transaction. Locks are taken in one order: run, submission,
upload, team. A draft declares its file (sha256, size); no other file is accepted. Stages end a submission with `settle`
in `services/domain/benchmarks/submissions/state_machine.py`, the sweeper with
`services/domain/benchmarks/submissions/sweeper_chores.py`.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

from sqlalchemy import func, select, update
from sqlalchemy.orm import Session

from services.domain.benchmarks.phases import evaluation_versions
from services.domain.benchmarks.phases.errors import no_ground_truth
from services.domain.benchmarks.phases.phases import DAY_NS, phase_status
from services.domain.benchmarks.submissions import scoring_quota
from services.domain.benchmarks.submissions.errors import (
    ExhaustedError,
    SubmissionStateError,
    phase_closed,
)
from services.domain.benchmarks.submissions.scoring_jobs import submission_specs
from services.domain.benchmarks.submissions.state_machine import (
    ENDED,
    OPEN,
    end,
    lock_submission,
    mark_scoring,
    reopen,
    settle,
)
from services.domain.benchmarks.submissions.sweeper_chores import settle_ended
from services.domain.benchmarks.teams.errors import already_in_team
from services.domain.benchmarks.teams.teams import enter, lock_team
from services.runtime.jobs.changes import lock_run
from services.runtime.jobs.control import cancel as cancel_run
from services.runtime.jobs.enqueue import enqueue_run
from services.runtime.jobs.errors import JobStateError
from services.runtime.jobs.specs import Context
from services.runtime.orm import GroundTruthRow, Job, Phase, PhaseTeam, SubmissionRow, Upload
from services.runtime.orm.base import now_ns
from services.runtime.telemetry.origins import link_to
from services.runtime.uploads import consume
from services.runtime.uploads.rows import is_waiting
from stone.errors import Refused

__all__ = [
    "SubmissionDraft",
    "cancel",
    "create_draft",
    "describe",
    "finalise",
    "hide",
    "largest_bytes",
    "mark_scoring",
    "reopen",
    "settle",
    "settle_ended",
    "unhide",
    "validations_left",
    "withdraw",
]

PURPOSE = "submission"
RUN = "score"
FRAME_BYTES = 3 * 2**20  # 2 MiB of voxels per frame plus headers; stored uncompressed
SLACK_BYTES = 2**20
MOST_OPEN = 40
KINDS = ("entry", "baseline", "validation")


@dataclass(frozen=True)
class SubmissionDraft:
    """A submission to create; `sha256` and `size_bytes` describe the zip that will be uploaded."""

    phase_id: str
    team_id: str
    user_id: str
    kind: str
    method: str
    description: str
    modality: str
    sha256: str
    size_bytes: int


def create_draft(session: Session, draft: SubmissionDraft) -> SubmissionRow:
    """Create a submission that announces a file.

    Raises `phase_closed`, `no_ground_truth`, `submission_too_large`, `too_many_open`, `validations_exhausted`, and
    `already_in_team` if the user takes part with another team.
    """
    if draft.kind not in KINDS:
        raise ValueError(f"submissions have no kind {draft.kind!r}")
    phase = session.get_one(Phase, draft.phase_id)
    truth = _scored_against(session, phase)
    limit_bytes = largest_bytes(truth.frames)
    if draft.size_bytes > limit_bytes:
        raise Refused(
            "submission_too_large",
            f"the zip has {draft.size_bytes} bytes, but {truth.frames} frames never need more than {limit_bytes}; "
            "does the zip contain anything other than one .npz per frame?",
        )
    bound = session.get(PhaseTeam, (phase.id, draft.user_id))
    if bound is not None and bound.team_id != draft.team_id:  # finalising would refuse it after the whole upload
        raise already_in_team(phase.name)
    lock_team(session, draft.team_id)
    _refuse_too_many(session, draft)
    if draft.kind == "validation":
        _refuse_exhausted(session, phase, draft.team_id)
    row = SubmissionRow(phase_id=phase.id, team_id=draft.team_id, user_id=draft.user_id, kind=draft.kind)
    row.method, row.description, row.modality = draft.method, draft.description, draft.modality
    row.declared_sha256, row.size_bytes, row.state = draft.sha256, draft.size_bytes, "draft"
    session.add(row)
    session.flush()
    return row


def largest_bytes(frames: int) -> int:
    """Return the largest size of a zip with this many frames."""
    return frames * FRAME_BYTES + SLACK_BYTES


def finalise(session: Session, submission: SubmissionRow, upload_id: str) -> Job:
    """Consume the draft's complete upload, take a scoring if the kind costs one, and queue the run; all or nothing.

    From then on the team takes part in the phase. Raises `SubmissionStateError`, `phase_closed`, `no_ground_truth`,
    what `uploads.consume` raises, `hash_mismatch`, `already_in_team`, `scorings_exhausted`, `validations_exhausted`,
    `QueueDrainingError`.
    """
    submission = lock_submission(session, submission.id)
    if submission.state != "draft":
        raise SubmissionStateError(submission.id, submission.state, "finalised", "draft")
    phase = session.get_one(Phase, submission.phase_id)
    _scored_against(session, phase)
    upload = _consume_upload(session, submission, upload_id)
    enter(session, phase, submission.team_id)
    if scoring_quota.is_charged(phase, submission.kind):
        scoring_quota.reserve(session, phase, submission.team_id, submission.id)
    elif submission.kind == "validation":
        lock_team(session, submission.team_id)
        _refuse_exhausted(session, phase, submission.team_id)
    link_to(upload.traceparent)
    run = enqueue_run(session, RUN, submission_specs(submission), Context(upload.owner_id))
    run.arguments = {"submission_id": submission.id}
    submission.state, submission.finalized_ns = "queued", now_ns()
    submission.upload_id, submission.job_id = upload.id, run.id
    submission.revision += 1
    session.flush()
    _end_uploads(session, submission.id)
    return run


def cancel(session: Session, submission: SubmissionRow, reason: str = "") -> SubmissionRow:
    """End an unsettled submission: cancel its run and immediately release its scoring, within bounds.

    Raises `SubmissionStateError` if it has ended.
    """
    job_id = session.scalar(select(SubmissionRow.job_id).where(SubmissionRow.id == submission.id))
    if job_id is not None:
        lock_run(session, job_id)
    submission = lock_submission(session, submission.id)
    if submission.state not in OPEN or submission.job_id != job_id:  # finalised concurrently: try again
        raise SubmissionStateError(submission.id, submission.state, "cancelled now", ", ".join(OPEN))
    if job_id is not None:
        with suppress(JobStateError):  # the run ended without settling the submission
            cancel_run(session, job_id, reason or "its submission was cancelled")
    end(session, submission, "cancelled")
    session.flush()
    _end_uploads(session, submission.id)
    return submission


def withdraw(session: Session, submission: SubmissionRow) -> SubmissionRow:
    """Remove a settled submission from all boards for good; its scoring stays used. Raises `SubmissionStateError`."""
    submission = lock_submission(session, submission.id)
    if submission.state not in ENDED:
        raise SubmissionStateError(submission.id, submission.state, "withdrawn", "settled")
    if submission.withdrawn_ns is not None:
        raise SubmissionStateError(submission.id, "withdrawn already", "withdrawn again", "standing")
    submission.withdrawn_ns = now_ns()
    submission.revision += 1
    session.flush()
    return submission


def hide(session: Session, submission: SubmissionRow, reason: str) -> SubmissionRow:
    """Hide a submission from the boards until `unhide`; its team can read the reason."""
    submission = lock_submission(session, submission.id)
    submission.hidden_ns = submission.hidden_ns or now_ns()
    submission.hidden_reason = reason
    submission.revision += 1
    session.flush()
    return submission


def unhide(session: Session, submission: SubmissionRow) -> SubmissionRow:
    """Show the submission on the boards again."""
    submission = lock_submission(session, submission.id)
    submission.hidden_ns, submission.hidden_reason = None, ""
    submission.revision += 1
    session.flush()
    return submission


def describe(session: Session, submission: SubmissionRow, changes: Mapping[str, str]) -> SubmissionRow:
    """Change method, description and, for a draft, modality; the caller has locked the row.

    Raises `SubmissionStateError`.
    """
    changed = {name: value for name, value in changes.items() if getattr(submission, name) != value}
    if "modality" in changed and submission.state != "draft":
        raise SubmissionStateError(submission.id, submission.state, "moved to another track", "draft")
    for name, value in changed.items():
        setattr(submission, name, value)
    submission.revision += 1 if changed else 0
    session.flush()
    return submission


def validations_left(session: Session, phase: Phase, team_id: str) -> tuple[int, int | None]:
    """Return the number of validations the team has left, and when the next one is available; null for never.

    Cancelled validations count; failures not caused by the file do not.
    """
    since_ns = now_ns() - DAY_NS
    checked = select(SubmissionRow.finalized_ns).where(
        SubmissionRow.phase_id == phase.id, SubmissionRow.team_id == team_id
    )
    checked = checked.where(SubmissionRow.kind == "validation", SubmissionRow.state != "failed")
    checked = checked.where(SubmissionRow.finalized_ns > since_ns).order_by(SubmissionRow.finalized_ns)
    moments = [moment for moment in session.scalars(checked) if moment is not None]
    surplus = len(moments) - phase.validations_per_day
    if surplus < 0:
        return -surplus, now_ns()
    return 0, moments[surplus] + DAY_NS if phase.validations_per_day else None


def _scored_against(session: Session, phase: Phase) -> GroundTruthRow:
    """Return the ground truth of an open phase's board. Raises `phase_closed`, `no_ground_truth`."""
    at_ns = now_ns()
    if phase_status(phase, at_ns) != "open":
        raise phase_closed(phase.name, phase.opens_ns, phase.closes_ns, at_ns)
    pair = evaluation_versions.active(session, phase.id)
    if pair is None:
        raise no_ground_truth(phase.name)
    return session.get_one(GroundTruthRow, pair.truth_id)


def _refuse_too_many(session: Session, draft: SubmissionDraft) -> None:
    """Raise `too_many_open` if the team has too many open submissions."""
    ours = (SubmissionRow.phase_id == draft.phase_id, SubmissionRow.team_id == draft.team_id)
    opened = session.scalar(select(func.count()).select_from(SubmissionRow).where(*ours, SubmissionRow.state.in_(OPEN)))
    if (opened or 0) >= MOST_OPEN:
        raise Refused(
            "too_many_open",
            f"this team has {MOST_OPEN} unfinished submissions in this phase; finish or cancel some of them first",
        )


def _refuse_exhausted(session: Session, phase: Phase, team_id: str) -> None:
    """Raise `validations_exhausted` if the team has no validations left."""
    left, next_ns = validations_left(session, phase, team_id)
    if not left:
        limit = phase.validations_per_day
        sentence = (
            f"all {limit} validation-only submissions of the day are used ('stone validate' checks a file locally)"
        )
        raise ExhaustedError("validations_exhausted", sentence, next_ns)


def _consume_upload(session: Session, submission: SubmissionRow, upload_id: str) -> Upload:
    """Consume and return the upload that was made for this draft."""
    owner_id = session.scalar(select(Upload.owner_id).where(Upload.id == upload_id))
    if owner_id is None:
        raise Refused("upload_missing", f"you have no upload {upload_id[:64]!r}")
    upload = consume(session, upload_id, owner_id, PURPOSE)
    if upload.target_id != submission.id:
        raise Refused("upload_missing", f"you have no upload {upload_id[:64]!r}")
    if (upload.sha256, upload.length_bytes) != (submission.declared_sha256, submission.size_bytes):
        raise Refused(
            "hash_mismatch",
            f"the upload has sha256 {upload.sha256 or 'unknown'}, but {submission.declared_sha256} was declared; did "
            "the zip change meanwhile?",
        )
    return upload


def _end_uploads(session: Session, submission_id: str) -> None:
    """End all other uploads for this submission; the sweeper deletes their bytes."""
    waiting = (Upload.purpose == PURPOSE, Upload.target_id == submission_id, is_waiting())
    ending = update(Upload).where(*waiting).values(expires_ns=now_ns())
    session.execute(ending, execution_options={"synchronize_session": False})
