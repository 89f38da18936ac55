"""Job specs that score a submission, re-score one, and build a ground truth.

    eval.open → eval.part (each range of frames) → eval.join; then both again by every pending evaluation version

**Conventions.** Arguments hold ids and numbers only. `start`, `stop` are those of a range of `scoring_ranges.py`.
A join counts by itself what no part has counted, so a small submission needs no parts; and it reads the kept counts
where the submission was scored against the same truth before, so another metric needs no zip. Keys name jobs of one
evaluation version, whose submissions may be many.
"""

from collections.abc import Iterable

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.benchmarks.phases.evaluation_versions import EvaluationVersion
from services.domain.benchmarks.submissions.scoring_ranges import Span, ranges_of
from services.runtime.jobs.specs import JobSpec
from services.runtime.orm import GroundTruthRow, Score, SubmissionRow

OPEN, PART, JOIN, TRUTH = "eval.open", "eval.part", "eval.join", "eval.truth"


def submission_specs(submission: SubmissionRow) -> tuple[JobSpec, ...]:
    """The first jobs of a run that checks and, unless its kind is validation, scores a submission."""
    return (JobSpec(OPEN, {"submission_id": submission.id}, key=f"open {submission.id}"),)


def truth_spec(truth: GroundTruthRow) -> JobSpec:
    """The job that builds a ground truth."""
    return JobSpec(TRUTH, {"truth_id": truth.id})


def rescore_specs(session: Session, submission_ids: Iterable[str], pair: EvaluationVersion) -> tuple[JobSpec, ...]:
    """The jobs that score these submissions by `pair`, in their order; none for those that have that score."""
    ids = tuple(submission_ids)
    frames = session.get_one(GroundTruthRow, pair.truth_id).frames
    metrics: dict[str, set[str]] = {}
    scored = select(Score.submission_id, Score.metric).where(Score.truth_id == pair.truth_id)
    for submission_id, metric in session.execute(scored.where(Score.submission_id.in_(ids))):
        metrics.setdefault(submission_id, set()).add(metric)
    return tuple(
        spec
        for submission_id in ids
        if pair.metric not in metrics.get(submission_id, ())
        for spec in scoring_specs(submission_id, pair, 0 if submission_id in metrics else frames)
    )


def scoring_specs(submission_id: str, pair: EvaluationVersion, frames: int) -> tuple[JobSpec, ...]:
    """Parts of the `frames` frames that are to be counted, none for one part's worth; then the join."""
    whose = {"submission_id": submission_id, "truth_id": pair.truth_id}
    parts = tuple(
        JobSpec(PART, {**whose, "start": start, "stop": stop}, f"part {submission_id} {start}")
        for start, stop in _parts_of(frames)
    )
    waits = tuple(part.key for part in parts)
    return (*parts, JobSpec(JOIN, {**whose, "metric": pair.metric}, f"join {submission_id}", waits))


def _parts_of(frames: int) -> tuple[Span, ...]:
    """The ranges that get a job of their own; none where one join can count them all."""
    ranges = ranges_of(frames)
    return ranges if len(ranges) > 1 else ()
