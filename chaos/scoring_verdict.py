"""Invariants of a submission after its jobs have ended, whatever process was killed meanwhile.

**Conventions.** Everything is read from the database and the store, and compared with an undisturbed submission of the
same file.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from chaos.verdict import Violation
from services.domain.benchmarks.submissions.scoring_quota import scoring_quota
from services.runtime.orm import Job, JobAttempt, Phase, Score, ScorePart, ScoringEntry, SubmissionRow
from services.runtime.platform import Platform
from services.runtime.uploads import upload_file

SCORE_COLUMNS = ("metric", "signature", "miou", "confusions_sha256", "spectra_sha256", "content_sha256", "record")


@dataclass(frozen=True)
class SubmissionOutcome:
    """The results of a submission: its state and problems, scores, entries in the ledger, jobs by kind."""

    state: str
    failure: str
    problems: Mapping[str, Any] | None
    scores: tuple[tuple[Any, ...], ...]
    ledger: tuple[tuple[int, str], ...]
    jobs: Mapping[str, int]


def came_of(platform: Platform, submission_id: str) -> SubmissionOutcome:
    """Return the results from the current rows."""
    with platform.database.reading() as session:
        row = session.get_one(SubmissionRow, submission_id)
        scores = session.scalars(select(Score).where(Score.submission_id == row.id).order_by(Score.id)).all()
        entries = select(ScoringEntry).where(ScoringEntry.submission_id == row.id).order_by(ScoringEntry.id)
        kinds = session.scalars(select(Job.kind).where(Job.root_id == row.job_id, Job.queue != "")).all()
        return SubmissionOutcome(
            state=row.state,
            failure=row.failure,
            problems=row.problems,
            scores=tuple(tuple(getattr(score, name) for name in SCORE_COLUMNS) for score in scores),
            ledger=tuple((entry.amount, entry.reason) for entry in session.scalars(entries)),
            jobs=Counter(kinds),
        )


def judge(platform: Platform, submission_id: str, expected: SubmissionOutcome) -> list[Violation]:
    """Return every difference between the submission and an undisturbed one."""
    violations = list(_differences(came_of(platform, submission_id), expected))
    with platform.database.reading() as session:
        row = session.get_one(SubmissionRow, submission_id)
        violations += [*_judge_jobs(session, row), *_judge_left(session, row)]
    if upload_file(platform.settings, row.upload_id or "").exists():
        violations.append(Violation("doubled", f"the upload of submission {row.id} still exists beside its blob"))
    if row.blob_sha256 != row.declared_sha256:
        violations.append(Violation("lost", f"submission {row.id} is kept as {row.blob_sha256}"))
    return violations


def judge_quota(platform: Platform, phase_id: str, team_id: str) -> Iterator[Violation]:
    """Yield a violation unless the team's quota equals its scored submissions, without a reservation for ended work."""
    with platform.database.reading() as session:
        ours = (SubmissionRow.phase_id == phase_id, SubmissionRow.team_id == team_id, SubmissionRow.state == "scored")
        scored = session.scalar(select(func.count()).select_from(SubmissionRow).where(*ours)) or 0
        now = scoring_quota(session, session.get_one(Phase, phase_id), team_id)
    if (now.used, now.reserved) != (scored, 0):
        yield Violation("lost", f"{scored} submissions are scored; {now.used} are counted, {now.reserved} reserved")


def _differences(came: SubmissionOutcome, expected: SubmissionOutcome) -> Iterator[Violation]:
    for name, value in vars(expected).items():
        actual = getattr(came, name)
        if actual != value:
            yield Violation("differing", f"{name}: {str(actual)[:200]}, undisturbed {str(value)[:200]}")


def _judge_jobs(session: Session, row: SubmissionRow) -> Iterator[Violation]:
    """Yield a violation unless each job succeeded once and its other attempts were lost to kills."""
    of_run = select(Job).where(Job.root_id == row.job_id)
    for job in session.scalars(of_run):
        if job.state != "succeeded":
            yield Violation("lost", f"{job.kind} is {job.state}: {job.failure}")
        attempts = select(JobAttempt.outcome).where(JobAttempt.job_id == job.id)
        outcomes = Counter(session.scalars(attempts))
        if job.queue and (outcomes["succeeded"] != 1 or set(outcomes) - {"succeeded", "lost"}):
            yield Violation("doubled", f"{job.kind} ended {dict(outcomes)}")


def _judge_left(session: Session, row: SubmissionRow) -> Iterator[Violation]:
    parts = session.scalar(select(func.count()).select_from(ScorePart).where(ScorePart.submission_id == row.id))
    if parts:
        yield Violation("doubled", f"{parts} counted parts were left")
