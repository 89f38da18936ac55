"""Submissions as response bodies for their team and administrators; scores are in `results`.

**Conventions.** Who may see one is decided by `api/visible.py`.
"""

from collections.abc import Sequence
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from api.schemas.base import instant, instant_or_none
from api.schemas.jobs import FailureItem
from api.schemas.submissions import (
    FileProblem,
    StandingAnswer,
    SubmissionDetail,
    SubmissionItem,
    SubmissionProgress,
    ValidationReport,
)
from api.views.jobs import job_items
from services.domain.benchmarks.submissions import scoring_quota
from services.domain.benchmarks.submissions.completion_estimate import expected_s, queue_position
from services.domain.benchmarks.submissions.state_machine import LIVE
from services.domain.benchmarks.submissions.submissions import validations_left
from services.runtime.orm import Job, Phase, SubmissionRow, Upload
from services.runtime.uploads.rows import is_waiting

SHOWN = 100


def submission_items(session: Session, rows: Sequence[SubmissionRow]) -> list[SubmissionItem]:
    """Submissions as a list shows them; the progress of all their runs is one statement."""
    runs = [row.job_id for row in rows if row.state in LIVE and row.job_id]
    jobs = session.scalars(select(Job).where(Job.id.in_(runs))).all() if runs else []
    progress = {
        item.id: SubmissionProgress(done=item.progress.done, total=item.progress.total)
        for item in job_items(session, jobs)
    }
    return [SubmissionItem(**_facts(session, row, progress.get(row.job_id or ""))) for row in rows]


def submission_detail(session: Session, row: SubmissionRow) -> SubmissionDetail:
    """A submission with its method's page."""
    shown = submission_items(session, [row])[0]
    more: dict[str, Any] = {"description": row.description, "upload_id": _upload_id(session, row)}
    return SubmissionDetail(**dict(shown), **more, expected_s=expected_s(session, row))


def validation_report(row: SubmissionRow) -> ValidationReport:
    """The validation problems of the file."""
    problems = row.problems or {}
    is_checked = row.problems is not None or row.state in ("scored", "valid")
    state: Any = row.state
    return ValidationReport(
        submission_id=row.id,
        state=state,
        ok=not problems.get("errors_total", 0) if is_checked else None,
        errors=[FileProblem.model_validate(one) for one in problems.get("errors", ())[:SHOWN]],
        errors_total=problems.get("errors_total", 0),
        failure=_failure(row),
    )


def quota_answer(session: Session, phase: Phase, team_id: str) -> StandingAnswer:
    """The team's remaining scorings and validations."""
    standing = scoring_quota.scoring_quota(session, phase, team_id)
    left, next_validation_ns = validations_left(session, phase, team_id)
    return StandingAnswer(
        phase_id=phase.id,
        team_id=team_id,
        limit=standing.limit,
        used=standing.used,
        reserved=standing.reserved,
        total_left=standing.total_left,
        window_s=standing.window_ns / 1e9,
        next_slot_at=instant_or_none(standing.next_slot_ns),
        validations_per_day=phase.validations_per_day,
        validations_left=left,
        next_validation_at=instant_or_none(next_validation_ns),
    )


def _facts(session: Session, row: SubmissionRow, progress: SubmissionProgress | None) -> dict[str, Any]:
    names = ("id", "phase_id", "team_id", "user_id", "kind", "method", "modality", "state", "size_bytes", "job_id")
    return {
        **{name: getattr(row, name) for name in (*names, "revision", "hidden_reason")},
        "sha256": row.declared_sha256,
        "queue_position": queue_position(session, row),
        "progress": progress,
        "problems_total": _problems_total(row),
        "failure": _failure(row),
        "created_at": instant(row.created_ns),
        "finalized_at": instant_or_none(row.finalized_ns),
        "settled_at": instant_or_none(row.settled_ns),
        "withdrawn_at": instant_or_none(row.withdrawn_ns),
        "hidden_at": instant_or_none(row.hidden_ns),
    }


def _problems_total(row: SubmissionRow) -> int | None:
    if row.problems is None:
        return 0 if row.state in ("scored", "valid") else None
    return int(row.problems.get("errors_total", 0))


def _failure(row: SubmissionRow) -> FailureItem | None:
    return FailureItem(code=row.failure_code, sentence=row.failure) if row.failure_code else None


def _upload_id(session: Session, row: SubmissionRow) -> str | None:
    """The upload that was used up, or the newest that is on its way: where a client goes on."""
    if row.upload_id is not None or row.state != "draft":
        return row.upload_id
    alive = select(Upload.id).where(Upload.target_id == row.id, Upload.purpose == "submission")
    return session.scalar(alive.where(is_waiting()).order_by(Upload.id.desc()).limit(1))
