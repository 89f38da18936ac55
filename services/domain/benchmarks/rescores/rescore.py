"""Re-scoring: scores all entries of a phase by another evaluation version, then switches the board at once.

    start_rescore → (its run) → rescore_progress, the differences → activate, or abandon

**Conventions.** A re-score is pending until it is activated or abandoned; meanwhile new submissions are also scored by
its evaluation version (`evaluation_versions.py`). Starting, activating and abandoning lock the phase's row, after the
row of a run.
"""

from dataclasses import dataclass

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.benchmarks.phases.evaluation_versions import EvaluationVersion, active, in_force
from services.domain.benchmarks.phases.phases import lock_phase
from services.domain.benchmarks.rescores.errors import RescoreStateError
from services.domain.benchmarks.rescores.progress import failed_ids, lacking_ids, rescore_progress
from services.domain.benchmarks.submissions.scoring_jobs import rescore_specs
from services.runtime.jobs import control
from services.runtime.jobs.changes import lock_run
from services.runtime.jobs.enqueue import enqueue_run
from services.runtime.jobs.specs import TERMINAL, Context
from services.runtime.orm import Activation, GroundTruthRow, Job, Phase, Rescore
from services.runtime.orm.base import now_ns
from stone.errors import Refused
from stone.scoring.metric import current_metric

RUN = "phase.rescore"
PRIORITY = -10  # new submissions first


@dataclass(frozen=True)
class NewRescore:
    """A re-score to start, with the administrator's reason."""

    pair: EvaluationVersion
    user_id: str
    reason: str


def start_rescore(session: Session, phase: Phase, new: NewRescore) -> tuple[Rescore, Job | None]:
    """Return the re-score of the phase by the version, and the run that scores what is missing (None if nothing is).

    A re-score by the board's own evaluation version is refused unless an entry lacks that score (for example an entry
    that was hidden and is shown again). If a re-score by this version is pending, it is returned: its run continues, or
    a new run scores what is missing if the run has ended. Raises `unknown_metric`, `superseded_metric`,
    `ground_truth_of_other_phase`, `truth_not_ready`, `already_active`, `QueueDrainingError`.
    """
    lock_phase(session, phase.id)
    pair = new.pair
    _check(session, phase, pair)
    rescore = _pending(session, phase, pair) or _new(session, phase, new)
    run = session.get(Job, rescore.job_id) if rescore.job_id else None
    if run is not None and run.state not in TERMINAL:
        return rescore, run
    failed = failed_ids(session, rescore.job_id)
    # The first failure ends a run, so submissions that failed before come last.
    lacking = sorted(
        lacking_ids(session, phase.id, pair), key=lambda submission_id: (submission_id in failed, submission_id)
    )
    if not lacking:
        return rescore, None
    specs = rescore_specs(session, lacking, pair)
    run = enqueue_run(session, RUN, specs, Context(new.user_id, priority=PRIORITY))
    rescore.job_id = run.id
    session.flush()
    return rescore, run


def activate(session: Session, rescore: Rescore, expected_activation_id: str | None, user_id: str) -> Activation:
    """Switch the board to the evaluation version of `rescore` at once; the old version stays readable.

    Raises `RescoreStateError`, `truth_not_ready`, `rescore_incomplete`, and `leaderboard_changed` if the active
    activation is not the expected one.
    """
    lock_phase(session, rescore.phase_id)
    _refuse_ended(session, rescore, "activated")
    now_there = in_force(session, rescore.phase_id)
    if (now_there.id if now_there else None) != expected_activation_id:
        raise Refused(
            "leaderboard_changed",
            f"the board is at activation {(now_there.id if now_there else None)}, not at {expected_activation_id}; "
            "review the differences again",
        )
    _ready(session, rescore.truth_id)
    progress = rescore_progress(session, rescore)
    if not progress.is_complete:
        raise Refused(
            "rescore_incomplete",
            f"{progress.missing} entries have no score by the new evaluation version yet; wait for its run. If the "
            "run has ended, start the re-score again to score the missing entries (hide an entry that cannot be "
            "scored)",
        )
    moment_ns = max(now_ns(), now_there.activated_ns + 1 if now_there else 0)
    row = Activation(phase_id=rescore.phase_id, truth_id=rescore.truth_id, metric=rescore.metric)
    row.rescore_id, row.activated_by, row.activated_ns = rescore.id, user_id, moment_ns
    session.add(row)
    rescore.activated_ns = moment_ns
    session.flush()
    return row


def abandon(session: Session, rescore: Rescore, reason: str) -> None:
    """Abandon the re-score: stop its run and stop scoring new submissions by its version; scores stay.

    Raises `RescoreStateError`.
    """
    if rescore.job_id is not None:
        lock_run(session, rescore.job_id)
    lock_phase(session, rescore.phase_id)
    _refuse_ended(session, rescore, "abandoned")
    rescore.abandoned_ns = now_ns()
    run = session.get(Job, rescore.job_id) if rescore.job_id else None
    if run is not None and run.state not in TERMINAL:
        control.cancel(session, run.id, f"the re-score was abandoned: {reason}")
    session.flush()


def old_version(session: Session, rescore: Rescore) -> EvaluationVersion | None:
    """Return the version to compare with: the active one, or the one before the re-score's own activation."""
    until_ns = None if rescore.activated_ns is None else rescore.activated_ns - 1
    return active(session, rescore.phase_id, until_ns)


def _check(session: Session, phase: Phase, pair: EvaluationVersion) -> None:
    current_metric(pair.metric)
    truth = session.get(GroundTruthRow, pair.truth_id)
    if truth is None or truth.phase_id != phase.id:
        raise Refused(
            "ground_truth_of_other_phase",
            f"this phase has no ground truth {pair.truth_id[:80]!r}; does the ground truth belong to another phase?",
        )
    _ready(session, pair.truth_id)
    if active(session, phase.id) == pair and not lacking_ids(session, phase.id, pair):
        raise Refused(
            "already_active",
            f"the board already shows ground truth {truth.number} with {pair.metric!r}, so there is nothing to "
            "re-score; name another ground truth, another metric, or both",
        )


def _ready(session: Session, truth_id: str) -> None:
    truth = session.get_one(GroundTruthRow, truth_id, populate_existing=True)
    if truth.ready_ns is None:
        raise Refused(
            "truth_not_ready",
            f"ground truth {truth.number} is not ready; wait for its job, or create another ground truth if the job "
            "has failed",
        )


def _refuse_ended(session: Session, rescore: Rescore, act: str) -> None:
    session.refresh(rescore)
    if rescore.activated_ns is not None or rescore.abandoned_ns is not None:
        raise RescoreStateError(rescore.id, "abandoned" if rescore.activated_ns is None else "activated", act)


def _pending(session: Session, phase: Phase, pair: EvaluationVersion) -> Rescore | None:
    mine = (Rescore.phase_id == phase.id, Rescore.truth_id == pair.truth_id, Rescore.metric == pair.metric)
    open_ones = select(Rescore).where(*mine, Rescore.activated_ns.is_(None), Rescore.abandoned_ns.is_(None))
    return session.scalars(open_ones.order_by(Rescore.id).limit(1)).first()


def _new(session: Session, phase: Phase, new: NewRescore) -> Rescore:
    row = Rescore(phase_id=phase.id, truth_id=new.pair.truth_id, metric=new.pair.metric, reason=new.reason)
    row.created_by = new.user_id
    session.add(row)
    session.flush()
    return row
