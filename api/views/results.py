"""Submission results as response bodies, limited to what the caller may see."""

from sqlalchemy.orm import Session

from api.deps import Caller
from api.errors import NotFoundError
from api.schemas.base import instant, instant_or_none
from api.schemas.leaderboard import IntervalsItem, RatiosItem, SupportItem
from api.schemas.results import (
    BreakdownAnswer,
    ExtrasItem,
    PartItem,
    ProvenanceAnswer,
    ResultsAnswer,
    ScopedIntervals,
    ScopedSilences,
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
    """The caller as a viewer of submissions."""
    if caller.is_visitor:
        return Viewer(is_visitor=True)
    return viewer_of(session, caller.user_id, caller.is_administrator)


def known_submission(session: Session, viewer: Viewer, submission_id: str) -> SubmissionRow:
    """Raises `NotFoundError`."""
    found = submission_seen(session, viewer, submission_id)
    if found is None:
        raise NotFoundError("submission", submission_id)
    return found


def known_score(session: Session, caller: Caller, submission_id: str, score_id: str | None) -> ScoreView:
    """Raises `NotFoundError`, `NotScoredError`, `ScoreMissingError`."""
    viewer = viewer_for(session, caller)
    return seen_score(session, viewer, known_submission(session, viewer, submission_id), score_id)


def results_answer(session: Session, viewer: Viewer, found: SubmissionResults) -> ResultsAnswer:
    seen, row = found.seen, found.seen.submission
    intervals = found.intervals
    return ResultsAnswer(
        submission_id=row.id,
        score_id=seen.score.id,
        benchmark=found.benchmark,
        phase=seen.phase.name,
        team=found.team,
        method=row.method,
        description=found.description,
        modality=row.modality,
        kind=row.kind,
        pair=evaluation_version_item(seen),
        secrecy=seen.policy.secrecy,
        is_rounded=found.is_rounded,
        ratio_digits=RATIO_DIGITS,
        total=RatiosItem(**found.total),
        within_occupied=None if found.within_occupied is None else RatiosItem(**found.within_occupied),
        support=None if found.support is None else SupportItem(**found.support),
        confusion=found.confusion,
        extras=None if found.extras is None else ExtrasItem(**found.extras),
        intervals=None
        if intervals is None
        else ScopedIntervals(**{scope: IntervalsItem(**one) for scope, one in intervals.items()}),
        silences=None
        if found.silences is None
        else ScopedSilences(**{scope: dict(one) for scope, one in found.silences.items()}),
        submitted_at=instant(row.finalized_ns or row.created_ns),
        scored_at=instant(seen.score.created_ns),
        scores=score_items(session, viewer, row),
    )


def score_items(session: Session, viewer: Viewer, submission: SubmissionRow) -> list[ScoreItem]:
    """The scores that may be read by their ids, oldest first."""
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
        parts=[
            PartItem(
                name=part.name,
                ratios=RatiosItem(**part.ratios),
                support=SupportItem(**part.support),
                frames=part.frames,
            )
            for part in parts
        ],
    )


def provenance_answer(found: Provenance) -> ProvenanceAnswer:
    seen, row = found.seen, found.seen.submission
    return ProvenanceAnswer(
        submission_id=row.id,
        score_id=seen.score.id,
        pair=evaluation_version_item(seen),
        manifest_sha256=seen.truth.manifest_sha256 or "",
        mask=seen.truth.mask,
        code_version=found.code_version,
        prediction_sha256=found.prediction_sha256,
        size_bytes=found.size_bytes,
        content_sha256=found.content_sha256,
        submitted_at=instant(row.finalized_ns or row.created_ns),
        settled_at=instant_or_none(row.settled_ns),
        scored_at=instant(seen.score.created_ns),
    )
