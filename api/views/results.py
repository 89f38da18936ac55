"""Submission results as response bodies, limited to what the caller may see."""

from sqlalchemy.orm import Session

from api.deps import Caller
from api.errors import NotFoundError
from api.schemas.base import instant
from api.schemas.results import (
    BreakdownAnswer,
    PartItem,
    ProvenanceAnswer,
    ResultsAnswer,
    ScoreItem,
)
from api.views.boards import evaluation_version_item
from services.domain.benchmarks.phases.evaluation_versions import EvaluationVersion, active
from services.domain.benchmarks.submissions.results import (
    BreakdownPart,
    By,
    Provenance,
    ScoreView,
    SubmissionResults,
    readable_scores,
    seen_score,
    submission_seen,
)
from services.domain.benchmarks.visibility import RATIO_DIGITS, Viewer, viewer_of
from services.runtime.orm import SubmissionRow


def viewer_for(session: Session, caller: Caller) -> Viewer:
    """Return the caller as a viewer of submissions."""
    if caller.is_visitor:
        return Viewer(is_visitor=True)
    return viewer_of(session, caller.user_id, caller.is_administrator)


def known_submission(session: Session, viewer: Viewer, submission_id: str) -> SubmissionRow:
    """Return a submission that the viewer may see. Raises `NotFoundError`."""
    submission = submission_seen(session, viewer, submission_id)
    if submission is None:
        raise NotFoundError("submission", submission_id)
    return submission


def known_score(session: Session, caller: Caller, submission_id: str, score_id: str | None) -> ScoreView:
    """Return a score that the caller may see. Raises `NotFoundError`, `NotScoredError`, `ScoreMissingError`."""
    viewer = viewer_for(session, caller)
    return seen_score(session, viewer, known_submission(session, viewer, submission_id), score_id)


def results_answer(session: Session, viewer: Viewer, found: SubmissionResults) -> ResultsAnswer:
    seen, row = found.seen, found.seen.submission
    return ResultsAnswer.of(
        found,
        submission_id=row.id,
        score_id=seen.score.id,
        phase=seen.phase.name,
        method=row.method,
        modality=row.modality,
        kind=row.kind,
        pair=evaluation_version_item(seen),
        secrecy=seen.policy.secrecy,
        ratio_digits=RATIO_DIGITS,
        submitted_at=row.finalized_ns or row.created_ns,
        scored_at=seen.score.created_ns,
        scores=score_items(session, viewer, row),
    )


def score_items(session: Session, viewer: Viewer, submission: SubmissionRow) -> list[ScoreItem]:
    """Return the scores that may be read by their ids, oldest first."""
    pair = active(session, submission.phase_id)
    return [
        ScoreItem(
            score_id=score.id,
            ground_truth=number,
            metric=score.metric,
            is_active=EvaluationVersion(score.truth_id, score.metric) == pair,
            scored_at=instant(score.created_ns),
        )
        for score, number in readable_scores(session, viewer, submission)
    ]


def breakdown_answer(seen: ScoreView, by: By, parts: tuple[BreakdownPart, ...]) -> BreakdownAnswer:
    return BreakdownAnswer(
        submission_id=seen.submission.id,
        score_id=seen.score.id,
        pair=evaluation_version_item(seen),
        by=by,
        parts=[PartItem.of(part) for part in parts],
    )


def provenance_answer(found: Provenance) -> ProvenanceAnswer:
    seen, row = found.seen, found.seen.submission
    return ProvenanceAnswer.of(
        found,
        submission_id=row.id,
        score_id=seen.score.id,
        pair=evaluation_version_item(seen),
        manifest_sha256=seen.truth.manifest_sha256 or "",
        mask=seen.truth.mask,
        submitted_at=row.finalized_ns or row.created_ns,
        settled_at=row.settled_ns,
        scored_at=seen.score.created_ns,
    )
