"""Submissions as response bodies for their team and administrators; scores are in `results`.

**Conventions.** `api/visible.py` decides who may see a submission.
"""

from collections.abc import Sequence
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from api.schemas.submissions import (
    FileProblem,
    StandingAnswer,
    SubmissionDetail,
    SubmissionItem,
    SubmissionProgress,
    ValidationReport,
)
from api.views.jobs import coded_failure, job_items
from services.domain.benchmarks.submissions import scoring_quota
from services.domain.benchmarks.submissions.completion_estimate import expected_s, queue_position
from services.domain.benchmarks.submissions.state_machine import LIVE
from services.domain.benchmarks.submissions.submissions import validations_left
from services.runtime.orm import Job, Phase, SubmissionRow, Upload
from services.runtime.uploads.rows import is_waiting

SHOWN = 100


def submission_items(session: Session, rows: Sequence[SubmissionRow]) -> list[SubmissionItem]:
    """Return submissions as a list shows them; one statement reads the progress of all their runs."""
    runs = [row.job_id for row in rows if row.state in LIVE and row.job_id]
    jobs = session.scalars(select(Job).where(Job.id.in_(runs))).all() if runs else []
    progress = {item.id: SubmissionProgress.of(item.progress) for item in job_items(session, jobs)}
    return [
        SubmissionItem.of(
            row,
            sha256=row.declared_sha256,
            queue_position=queue_position(session, row),
            progress=progress.get(row.job_id or ""),
            problems_total=_problems_total(row),
            failure=coded_failure(row),
        )
        for row in rows
    ]


def submission_detail(session: Session, row: SubmissionRow) -> SubmissionDetail:
    """Return a submission with its method's page."""
    shown = submission_items(session, [row])[0]
    more: dict[str, Any] = {"description": row.description, "upload_id": _upload_id(session, row)}
    return SubmissionDetail(**dict(shown), **more, expected_s=expected_s(session, row))


def validation_report(row: SubmissionRow) -> ValidationReport:
    """Return the validation problems of the file."""
    problems = row.problems or {}
    is_checked = row.problems is not None or row.state in ("scored", "valid")
    state: Any = row.state
    return ValidationReport(
        submission_id=row.id,
        state=state,
        ok=not problems.get("errors_total", 0) if is_checked else None,
        errors=[FileProblem.model_validate(problem) for problem in problems.get("errors", ())[:SHOWN]],
        errors_total=problems.get("errors_total", 0),
        failure=coded_failure(row),
    )


def quota_answer(session: Session, phase: Phase, team_id: str) -> StandingAnswer:
    """Return the team's remaining scorings and validations."""
    standing = scoring_quota.scoring_quota(session, phase, team_id)
    left, next_validation_ns = validations_left(session, phase, team_id)
    return StandingAnswer.of(
        standing,
        phase_id=phase.id,
        team_id=team_id,
        window_s=standing.window_ns / 1e9,
        validations_per_day=phase.validations_per_day,
        validations_left=left,
        next_validation_at=next_validation_ns,
    )


def _problems_total(row: SubmissionRow) -> int | None:
    if row.problems is None:
        return 0 if row.state in ("scored", "valid") else None
    return int(row.problems.get("errors_total", 0))


def _upload_id(session: Session, row: SubmissionRow) -> str | None:
    """Return the consumed upload, or the newest unfinished one, which a client resumes."""
    if row.upload_id is not None or row.state != "draft":
        return row.upload_id
    alive = select(Upload.id).where(Upload.target_id == row.id, Upload.purpose == "submission")
    return session.scalar(alive.where(is_waiting()).order_by(Upload.id.desc()).limit(1))
