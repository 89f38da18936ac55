"""Re-scoring: every standing entry of a phase scored by another pair, then one switch of the board.

    start_rescore → (its run) → rescore_progress, the difference → activate, or abandon

**Conventions.** A re-score is pending until it is activated or abandoned; meanwhile new submissions are scored by its
pair too (`pairs.py`). Standing are scored entries and baselines that were not withdrawn; hidden ones stand, since they
may be shown again. Gone are those of them that can have no new score because their zip was purged: they keep their old
one and leave the board. Whoever starts, activates or abandons locks the phase's row first.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from sqlalchemy import ColumnElement, Select, and_, exists, func, or_, select
from sqlalchemy.orm import Session, aliased

from services.runtime.benchmarks.pairs import Pair, active, in_force
from services.runtime.benchmarks.rescore_errors import (
    AlreadyActiveError,
    BoardMovedError,
    ForeignTruthError,
    RescoreIncompleteError,
    RescoreStateError,
    TruthNotReadyError,
)
from services.runtime.benchmarks.scoring_jobs import JOIN, rescore_specs
from services.runtime.jobs import steering
from services.runtime.jobs.queueing import enqueue_run
from services.runtime.jobs.specs import TERMINAL, Context
from services.runtime.orm import Activation, GroundTruth, Job, Phase, Rescore, Score, Submission, User
from services.runtime.orm.base import now_ns
from stone.metric import metric_of

RUN = "phase.rescore"
PRIORITY = -10  # new submissions first
RANKED_KINDS = ("entry", "baseline")


@dataclass(frozen=True)
class RescoreProgress:
    """Of `total` standing submissions `scored` have their new score, `missing` can still get it, `gone` cannot.

    `in_flight` were being scored when the re-score began, and will lack the new score when they are done.
    """

    total: int
    scored: int
    missing: int
    gone: int
    in_flight: int

    @property
    def is_complete(self) -> bool:
        return not self.missing and not self.in_flight


def start_rescore(session: Session, phase: Phase, pair: Pair, user: User, reason: str) -> tuple[Rescore, Job | None]:
    """The re-score of the phase by `pair`, and the run that scores what lacks it; None where nothing does.

    Where one by this pair is pending, it is that one: its run goes on, or, has that ended, another takes up what is
    missing. Raises `UnknownMetricError`, `ForeignTruthError`, `TruthNotReadyError`, `AlreadyActiveError`,
    `QueueDrainingError`.
    """
    lock_phase(session, phase.id)
    _check(session, phase, pair)
    rescore = _pending(session, phase, pair) or _new(session, phase, pair, user, reason)
    run = session.get(Job, rescore.job_id) if rescore.job_id else None
    if run is not None and run.state not in TERMINAL:
        return rescore, run
    specs = rescore_specs(session, session.scalars(_lacking(phase.id, pair)).all(), pair)
    if not specs:
        return rescore, None
    run = enqueue_run(session, RUN, specs, Context(user.id, priority=PRIORITY))
    rescore.job_id = run.id
    session.flush()
    return rescore, run


def rescore_progress(session: Session, rescore: Rescore) -> RescoreProgress:
    """How far it is, judged by the scores there are and not by its run."""
    pair = Pair(rescore.truth_id, rescore.metric)
    of_phase = _standing(rescore.phase_id)
    total, scored = _count(session, of_phase), _count(session, of_phase.where(_has_score(pair)))
    missing = _count(session, _lacking(rescore.phase_id, pair))
    in_flight = len(_uncovered(session, rescore.phase_id, pair))
    return RescoreProgress(total, scored, missing, total - scored - missing, in_flight)


def activate(session: Session, rescore: Rescore, expected_activation_id: str | None, user: User) -> Activation:
    """Switch the board to the pair of `rescore`, at once and as a whole; the old pair stays readable.

    Raises `RescoreStateError`, `TruthNotReadyError`, `RescoreIncompleteError`, and `BoardMovedError` where another
    activation than the expected one is in force.
    """
    lock_phase(session, rescore.phase_id)
    _refuse_ended(session, rescore, "activated")
    now_there = in_force(session, rescore.phase_id)
    if (now_there.id if now_there else None) != expected_activation_id:
        raise BoardMovedError(expected_activation_id, now_there.id if now_there else None)
    _ready(session, rescore.truth_id)
    progress = rescore_progress(session, rescore)
    if not progress.is_complete:
        raise RescoreIncompleteError(progress.missing, progress.in_flight)
    moment_ns = max(now_ns(), now_there.activated_ns + 1 if now_there else 0)
    row = Activation(phase_id=rescore.phase_id, truth_id=rescore.truth_id, metric=rescore.metric)
    row.rescore_id, row.activated_by, row.activated_ns = rescore.id, user.id, moment_ns
    session.add(row)
    rescore.activated_ns = moment_ns
    session.flush()
    return row


def abandon(session: Session, rescore: Rescore, reason: str) -> None:
    """Give the re-score up: its run stops, new submissions are not scored by its pair any more, scores stay.

    Raises `RescoreStateError`.
    """
    lock_phase(session, rescore.phase_id)
    _refuse_ended(session, rescore, "abandoned")
    rescore.abandoned_ns = now_ns()
    run = session.get(Job, rescore.job_id, populate_existing=True) if rescore.job_id else None
    if run is not None and run.state not in TERMINAL:
        steering.cancel(session, run.id, f"the re-score was abandoned: {reason}")
    session.flush()


def old_pair(session: Session, rescore: Rescore) -> Pair | None:
    """What the re-score is held against: the pair on the board now, or before its own activation."""
    until_ns = None if rescore.activated_ns is None else rescore.activated_ns - 1
    return active(session, rescore.phase_id, until_ns)


def lock_phase(session: Session, phase_id: str) -> None:
    """Until the end of the transaction; on SQLite that is the lock itself."""
    session.execute(select(Phase.id).where(Phase.id == phase_id).with_for_update(key_share=True))


def standing_ids(session: Session, phase_id: str) -> list[str]:
    """The submissions of the phase that stand, oldest first."""
    return list(session.scalars(_standing(phase_id).order_by(Submission.id)))


def _check(session: Session, phase: Phase, pair: Pair) -> None:
    metric_of(pair.metric)
    truth = session.get(GroundTruth, pair.truth_id)
    if truth is None or truth.phase_id != phase.id:
        raise ForeignTruthError(pair.truth_id)
    _ready(session, pair.truth_id)
    if active(session, phase.id) == pair:
        raise AlreadyActiveError(truth.number, pair.metric)


def _ready(session: Session, truth_id: str) -> None:
    truth = session.get_one(GroundTruth, truth_id, populate_existing=True)
    if truth.ready_ns is None:
        raise TruthNotReadyError(truth.number)


def _refuse_ended(session: Session, rescore: Rescore, act: str) -> None:
    session.refresh(rescore)
    if rescore.activated_ns is not None or rescore.abandoned_ns is not None:
        raise RescoreStateError(rescore.id, "abandoned" if rescore.activated_ns is None else "activated", act)


def _pending(session: Session, phase: Phase, pair: Pair) -> Rescore | None:
    mine = (Rescore.phase_id == phase.id, Rescore.truth_id == pair.truth_id, Rescore.metric == pair.metric)
    open_ones = select(Rescore).where(*mine, Rescore.activated_ns.is_(None), Rescore.abandoned_ns.is_(None))
    return session.scalars(open_ones.order_by(Rescore.id).limit(1)).first()


def _new(session: Session, phase: Phase, pair: Pair, user: User, reason: str) -> Rescore:
    row = Rescore(phase_id=phase.id, truth_id=pair.truth_id, metric=pair.metric, reason=reason, created_by=user.id)
    session.add(row)
    session.flush()
    return row


def _standing(phase_id: str) -> Select[str]:
    of_phase = (Submission.phase_id == phase_id, Submission.kind.in_(RANKED_KINDS), Submission.state == "scored")
    return select(Submission.id).where(*of_phase, Submission.withdrawn_ns.is_(None))


def _has_score(pair: Pair) -> ColumnElement[bool]:
    by_pair = (Score.truth_id == pair.truth_id, Score.metric == pair.metric)
    return exists().where(Score.submission_id == Submission.id, *by_pair)


def _lacking(phase_id: str, pair: Pair) -> Select[str]:
    """Standing submissions without the score that can have it: from their zip, or from counts that are kept."""
    counted = aliased(Score)
    has_counts = exists().where(counted.submission_id == Submission.id, counted.truth_id == pair.truth_id)
    can_be_scored = or_(Submission.blob_sha256.is_not(None), has_counts)
    return _standing(phase_id).where(and_(~_has_score(pair), can_be_scored)).order_by(Submission.id)


def _uncovered(session: Session, phase_id: str, pair: Pair) -> list[str]:
    """Submissions being scored whose run was made before the pair was pending, so that it has no join for it."""
    kinds = (Submission.phase_id == phase_id, Submission.kind.in_(RANKED_KINDS), Submission.state == "scoring")
    scoring = dict(session.execute(select(Submission.id, Submission.job_id).where(*kinds, ~_has_score(pair))).all())
    return sorted(scoring.keys() - _joined_by(session, scoring.values(), pair))


def _joined_by(session: Session, run_ids: Iterable[str | None], pair: Pair) -> set[str]:
    """The submissions that a join of these runs scores by the pair."""
    joins = select(Job.arguments).where(Job.root_id.in_([one for one in run_ids if one]), Job.kind == JOIN)
    asked = [arguments for arguments in session.scalars(joins) if arguments]
    return {one["submission_id"] for one in asked if Pair(one["truth_id"], one["metric"]) == pair}


def _count(session: Session, ids: Select[str]) -> int:
    return session.scalar(select(func.count()).select_from(ids.order_by(None).subquery())) or 0
