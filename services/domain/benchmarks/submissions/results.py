"""Results of a submission: totals, breakdowns, provenance, counts, limited to what the viewer may see.

**Conventions.** Without a score id the score by the active evaluation version is used. Only administrators may read
scores of evaluation versions that were never active, such as those of a pending re-score. Withheld values are null
within a response, and refused (`withheld`) if they are the whole response.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session, defer, undefer

from services.domain.benchmarks.phases.evaluation_versions import EvaluationVersion, active
from services.domain.benchmarks.submissions.result_errors import UNTIL, NotScoredError, ScoreMissingError
from services.domain.benchmarks.visibility import Field, Policy, Viewer, policy_of, submissions_seen
from services.runtime.orm import Activation, Benchmark, Blob, GroundTruthRow, Phase, Score, SubmissionRow, Team
from services.runtime.orm.base import now_ns
from stone.errors import Refused
from stone.scoring.confusion import danger
from stone.scoring.intervals import SCOPES, WITHDRAWN, Scope, Silence
from stone.scoring.metric import RATIOS

By = Literal["sequence", "environment", "illumination", "distance"]
Record = Mapping[str, Any]
Ratios = Mapping[str, float | None]

BY: tuple[By, ...] = get_args(By)


@dataclass(frozen=True)
class ScoreView:
    """A submission, one of its scores, and the viewer's policy for them."""

    submission: SubmissionRow
    phase: Phase
    score: Score
    truth: GroundTruthRow
    policy: Policy
    is_active: bool

    def demand(self, field: Field, what: str) -> None:
        """Raise `withheld` if the viewer may not see the field."""
        if not self.policy.shows(field):
            raise Refused("withheld", f"{what} of this submission cannot be shown: {UNTIL[self.policy.secrecy]}")

    def unless_withheld(self, field: Field, name: str) -> Any:
        """Return the record's value with this name, or null if withheld."""
        return self.score.record.get(name) if self.policy.shows(field) else None


@dataclass(frozen=True)
class SubmissionResults:
    """Totals and the visible details of a submission.

    - confusion (4, 4) and supports of all evaluated voxels
    - intervals by scope and ratio, or the reason for their absence
    - `is_rounded`: whether the totals are rounded
    - the team, unless it is still unnamed
    """

    seen: ScoreView
    benchmark: str
    team: str | None
    description: str | None
    total: Ratios
    is_rounded: bool
    within_occupied: Ratios | None
    tolerant: Ratios | None
    columns: Ratios | None
    support: Mapping[str, int] | None
    confusion: list[list[int]] | None
    extras: Ratios | None
    intervals: Mapping[Scope, Mapping[str, tuple[float, float] | None]] | None
    silences: Mapping[Scope, Mapping[str, Silence | None]] | None


@dataclass(frozen=True)
class BreakdownPart:
    """The scores of one sequence, environment, illumination or ring of distance."""

    name: str
    ratios: Ratios
    support: Mapping[str, int]
    frames: int


@dataclass(frozen=True)
class Provenance:
    """The inputs of a score; digests of the file and the counts are null for viewers who may not see them."""

    seen: ScoreView
    code_version: str
    prediction_sha256: str | None
    size_bytes: int | None
    content_sha256: str | None


def submission_seen(session: Session, viewer: Viewer, submission_id: str) -> SubmissionRow | None:
    """Return the submission if it exists and the viewer may see it."""
    return session.scalars(submissions_seen(viewer).where(SubmissionRow.id == submission_id)).one_or_none()


def results(
    session: Session, viewer: Viewer, submission: SubmissionRow, score_id: str | None = None
) -> SubmissionResults:
    """Return the results. Raises `NotScoredError`, `ScoreMissingError`."""
    seen = seen_score(session, viewer, submission, score_id)
    shows_intervals = seen.policy.shows("intervals")
    return SubmissionResults(
        seen,
        benchmark=session.get_one(Benchmark, seen.phase.benchmark_id).name,
        team=session.get_one(Team, submission.team_id).name if seen.policy.shows("team") else None,
        description=submission.description if seen.policy.shows("description") else None,
        total={name: seen.policy.ratio(getattr(seen.score, name)) for name in RATIOS},
        is_rounded=not seen.policy.shows("exact"),
        within_occupied=seen.unless_withheld("extras", "within_occupied"),
        tolerant=seen.unless_withheld("extras", "tolerant"),
        columns=seen.unless_withheld("extras", "columns"),
        support=seen.unless_withheld("extras", "support"),
        confusion=seen.unless_withheld("extras", "confusion"),
        extras=_extras(seen.score.record) if seen.policy.shows("extras") else None,
        intervals=_by_scope(seen, "intervals", None) if shows_intervals else None,
        silences=_by_scope(seen, "silences", WITHDRAWN) if shows_intervals else None,
    )


def breakdown(seen: ScoreView, by: By) -> tuple[BreakdownPart, ...]:
    """Return the parts in the order of the record; empty if no sequence has this attribute. Raises `withheld`."""
    seen.demand("breakdowns", f"results by {by}")
    parts: Mapping[str, Record] = seen.score.record["by"].get(by, {})
    return tuple(
        BreakdownPart(name, {ratio: part[ratio] for ratio in RATIOS}, part["support"], part["frames"])
        for name, part in parts.items()
    )


def provenance(seen: ScoreView) -> Provenance:
    """Return the provenance of the score. Raises `withheld`."""
    seen.demand("provenance", "the provenance")
    is_own, is_content = seen.policy.shows("file"), seen.policy.shows("content")
    row = seen.submission
    return Provenance(
        seen,
        code_version=str(seen.score.record.get("code_version", "")),
        prediction_sha256=row.declared_sha256 if is_own else None,
        size_bytes=row.size_bytes if is_own else None,
        content_sha256=seen.score.content_sha256 if is_content else None,
    )


def kept_confusions(session: Session, seen: ScoreView) -> Blob:
    """Return the npz of the counts by frame and ring. Raises `withheld`."""
    seen.demand("confusions", "the confusions by frame")
    return session.get_one(Blob, seen.score.confusions_sha256)


def seen_score(session: Session, viewer: Viewer, submission: SubmissionRow, score_id: str | None = None) -> ScoreView:
    """Return the score with this id, by default by the active version. Raises `NotScoredError`, `ScoreMissingError`."""
    phase = session.get_one(Phase, submission.phase_id)
    policy = policy_of(viewer, phase, submission.team_id, now_ns())
    pair = active(session, phase.id)
    score = _score(session, submission, pair, score_id)
    if score is not None and not (policy.relation == "administrator" or _was_in_force(session, phase.id, score)):
        score = None
    if score is None:
        raise NotScoredError(submission.id, submission.state) if score_id is None else ScoreMissingError(submission.id)
    truth = session.get_one(GroundTruthRow, score.truth_id)
    return ScoreView(submission, phase, score, truth, policy, EvaluationVersion(score.truth_id, score.metric) == pair)


def readable_scores(session: Session, viewer: Viewer, submission: SubmissionRow) -> tuple[tuple[Score, int], ...]:
    """Return the scores without their records, with their ground truth numbers; oldest first."""
    of_submission = (
        select(Score, GroundTruthRow.number)
        .join(GroundTruthRow, GroundTruthRow.id == Score.truth_id)
        .options(defer(Score.record))
        .where(Score.submission_id == submission.id)
        .order_by(Score.id)
    )
    rows = [(score, number) for score, number in session.execute(of_submission)]
    if viewer.is_administrator:
        return tuple(rows)
    return tuple(row for row in rows if _was_in_force(session, submission.phase_id, row[0]))


def _extras(record: Record) -> Ratios:
    """Return the extras; records of earlier versions lack a few."""
    return {**danger(np.array(record["confusion"])), "clear_drivable_iou": None, **record["extras"]}


def _by_scope(seen: ScoreView, name: str, otherwise: Silence | None) -> Mapping[Scope, Any]:
    """Return this part of the record; `otherwise` for a score without silences, whose intervals are withdrawn."""
    by_scope: Mapping[Scope, Any] = seen.score.record[name] if "silences" in seen.score.record else {}
    return by_scope or {scope: dict.fromkeys(RATIOS, otherwise) for scope in SCOPES}


def _score(
    session: Session, submission: SubmissionRow, pair: EvaluationVersion | None, score_id: str | None
) -> Score | None:
    of_submission = select(Score).options(undefer(Score.record)).where(Score.submission_id == submission.id)
    if score_id is not None:
        return session.scalars(of_submission.where(Score.id == score_id)).one_or_none()
    if pair is None:
        return None
    by_version = of_submission.where(Score.truth_id == pair.truth_id, Score.metric == pair.metric)
    return session.scalars(by_version).one_or_none()


def _was_in_force(session: Session, phase_id: str, score: Score) -> bool:
    by_version = (Activation.truth_id == score.truth_id, Activation.metric == score.metric)
    activations = select(Activation.id).where(Activation.phase_id == phase_id, *by_version).limit(1)
    return session.scalar(activations) is not None
