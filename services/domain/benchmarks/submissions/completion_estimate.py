"""Estimated completion time of waiting and running submissions, from the pace of recent submissions.

**Conventions.** Work is counted in frames of the phase's ground truth. The pace is the number of frames of the last
completely read submissions, divided by the time in which at least one was processed. Idle hours do not slow the pace,
and parallel workers speed it up. Estimates are rounded up to `STEP_S`, so that they reveal no details of other runs.
"""

from collections.abc import Iterable, Mapping
from math import ceil

from sqlalchemy import case, func, select
from sqlalchemy.orm import Session

from services.domain.benchmarks.phases import evaluation_versions
from services.domain.benchmarks.submissions.scoring_jobs import OPEN
from services.domain.benchmarks.submissions.state_machine import LIVE
from services.runtime.jobs.specs import queue_of
from services.runtime.orm import GroundTruthRow, Job, Queue, SubmissionRow

RECENT = 30
STEP_S = 5
READ_THROUGH = ("scored", "valid")


def queue_position(session: Session, submission: SubmissionRow) -> int | None:
    """Return the number of queued submissions finalised before this one; None unless it is queued."""
    if submission.state != "queued":
        return None
    before = select(func.count()).select_from(SubmissionRow)
    return session.scalar(before.where(SubmissionRow.state == "queued", SubmissionRow.job_id < submission.job_id)) or 0


def expected_s(session: Session, submission: SubmissionRow) -> int | None:
    """Return the estimated seconds until the submission ends, at least `STEP_S`.

    None if it is neither queued nor being scored, if no earlier submission gives a pace, or while the queue is paused.
    """
    return expected_of(session, [submission]).get(submission.job_id or "")


def expected_of(session: Session, submissions: Iterable[SubmissionRow]) -> dict[str, int]:
    """Return the estimates of `expected_s` by run id, for the submissions that have an estimate."""
    job_ids = {submission.job_id for submission in submissions if submission.state in LIVE and submission.job_id}
    pace_hz = None if not job_ids or _is_paused(session) else _pace_hz(session)
    if pace_hz is None:
        return {}
    before = select(SubmissionRow.phase_id, SubmissionRow.job_id).where(SubmissionRow.state.in_(LIVE))
    waiting = session.execute(before.where(SubmissionRow.job_id <= max(job_ids)).order_by(SubmissionRow.job_id)).all()
    frames = _frames(session, {phase_id for phase_id, _ in waiting})
    left = _remaining_shares(session, [job_id for _, job_id in waiting if job_id])
    work, expected = 0.0, dict[str, int]()
    for phase_id, job_id in waiting:
        work += frames[phase_id] * left.get(job_id or "", 1.0)
        if job_id in job_ids:
            expected[job_id] = max(1, ceil(work / pace_hz / STEP_S)) * STEP_S
    return expected


def busy_ns(spans: Iterable[tuple[int, int]]) -> int:
    """Return the length of the union of half-open spans."""
    total = until = 0
    for start, stop in sorted(spans):
        total += max(0, stop - max(start, until))
        until = max(until, stop)
    return total


def _pace_hz(session: Session) -> float | None:
    """Return the frames per second of the last completely read submissions, or None without such submissions."""
    ended = select(SubmissionRow.phase_id, Job.started_ns, SubmissionRow.settled_ns).join(
        Job, Job.id == SubmissionRow.job_id
    )
    ended = ended.where(SubmissionRow.state.in_(READ_THROUGH), Job.started_ns.is_not(None))
    rows = session.execute(ended.order_by(SubmissionRow.settled_ns.desc()).limit(RECENT)).all()
    spans = [(start, stop) for _, start, stop in rows if start is not None and stop is not None and stop > start]
    frames = _frames(session, {phase_id for phase_id, _, _ in rows})
    done, lasted_ns = sum(frames[phase_id] for phase_id, _, _ in rows), busy_ns(spans)
    return done / (lasted_ns / 1e9) if done and lasted_ns else None


def _frames(session: Session, phase_ids: Iterable[str]) -> dict[str, int]:
    """Return the number of frames of each phase's active ground truth."""
    pairs = {phase_id: evaluation_versions.active(session, phase_id) for phase_id in phase_ids}
    return {
        phase_id: session.get_one(GroundTruthRow, pair.truth_id).frames if pair else 0
        for phase_id, pair in pairs.items()
    }


def _remaining_shares(session: Session, run_ids: list[str]) -> Mapping[str, float]:
    """Return the share of each run that remains, judged by the jobs known so far."""
    succeeded = func.sum(case((Job.state == "succeeded", 1), else_=0))
    of_runs = select(Job.root_id, succeeded, func.count()).where(Job.root_id.in_(run_ids), Job.queue != "")
    return {root_id: 1 - done / total for root_id, done, total in session.execute(of_runs.group_by(Job.root_id))}


def _is_paused(session: Session) -> bool:
    return session.scalar(select(Queue.mode).where(Queue.name == queue_of(OPEN))) == "paused"
