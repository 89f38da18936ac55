"""Job specs that score a submission, re-score one, and build a ground truth.

    eval.open → eval.part (each range of frames) → eval.join; then part and join for every pending evaluation version

**Conventions.** Arguments contain only ids and numbers. `start` and `stop` are a range of `scoring_ranges.py`. A join
counts the frames that no part has counted, so a small submission needs no parts. If the submission was already scored
against the same ground truth, the join reads the stored counts, so another metric needs no zip. Keys identify jobs of
one evaluation version, which may have many submissions.
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
    """Return the first jobs of a run that checks and, unless its kind is validation, scores a submission."""
    return (JobSpec(OPEN, {"submission_id": submission.id}, key=f"open {submission.id}"),)


def truth_spec(truth: GroundTruthRow) -> JobSpec:
    """Return the job that builds a ground truth."""
    return JobSpec(TRUTH, {"truth_id": truth.id})


def rescore_specs(session: Session, submission_ids: Iterable[str], pair: EvaluationVersion) -> tuple[JobSpec, ...]:
    """Return the jobs that score these submissions by `pair`, in their order, except for existing scores."""
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
    """Return jobs for the parts of `frames` frames (none if they fit into one part), followed by the join."""
    whose = {"submission_id": submission_id, "truth_id": pair.truth_id}
    parts = tuple(
        JobSpec(PART, {**whose, "start": start, "stop": stop}, f"part {submission_id} {start}")
        for start, stop in _parts_of(frames)
    )
    waits = tuple(part.key for part in parts)
    return (*parts, JobSpec(JOIN, {**whose, "metric": pair.metric}, f"join {submission_id}", waits))


def _parts_of(frames: int) -> tuple[Span, ...]:
    """Return the ranges that get their own jobs; none if one join can count all frames."""
    ranges = ranges_of(frames)
    return ranges if len(ranges) > 1 else ()
