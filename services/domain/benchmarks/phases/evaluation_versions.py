"""Evaluation versions: the ground truth and metric a phase is scored by, active or pending.

**Conventions.** An evaluation version is pending from the start of its re-score until that is activated or abandoned.
Whoever adds an activation stamps it later than the one before, so that at any time exactly one evaluation version is in
force.
"""

from dataclasses import dataclass

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.orm.benchmarks import Activation, Rescore


@dataclass(frozen=True)
class EvaluationVersion:
    """A ground truth and the version of the metric by which predictions are held against it."""

    truth_id: str
    metric: str


def in_force(session: Session, phase_id: str, at_ns: int | None = None) -> Activation | None:
    """The newest activation, or the newest of those until `at_ns` inclusive; None before the first."""
    query = select(Activation).where(Activation.phase_id == phase_id)
    if at_ns is not None:
        query = query.where(Activation.activated_ns <= at_ns)
    return session.scalars(query.order_by(Activation.activated_ns.desc(), Activation.id.desc()).limit(1)).first()


def active(session: Session, phase_id: str, at_ns: int | None = None) -> EvaluationVersion | None:
    """The evaluation version that the board shows, or showed at `at_ns`; None where no ground truth was ready yet."""
    found = in_force(session, phase_id, at_ns)
    return EvaluationVersion(found.truth_id, found.metric) if found else None


def pending(session: Session, phase_id: str) -> tuple[EvaluationVersion, ...]:
    """Pairs of re-scores that are neither activated nor abandoned, oldest first, each once."""
    query = select(Rescore.truth_id, Rescore.metric).where(
        Rescore.phase_id == phase_id, Rescore.activated_ns.is_(None), Rescore.abandoned_ns.is_(None)
    )
    return tuple(dict.fromkeys(EvaluationVersion(*found) for found in session.execute(query.order_by(Rescore.id))))


def versions_to_score(session: Session, phase_id: str) -> tuple[EvaluationVersion, ...]:
    """What a new submission is scored by: the active one first, then each pending one; empty before the first truth.

    A submission that is scored for the pending evaluation versions too leaves nothing to be caught up when one of them
    is activated.
    """
    first = active(session, phase_id)
    return tuple(dict.fromkeys((*((first,) if first else ()), *pending(session, phase_id))))
