"""Evaluation versions: the ground truth and metric a phase is scored by, active or pending.

**Conventions.** An evaluation version is pending from the start of its re-score until its activation or abandonment.
Each activation is stamped later than the previous one, so exactly one evaluation version is active at any time.
"""

from dataclasses import dataclass

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.orm.benchmarks import Activation, Rescore


@dataclass(frozen=True)
class EvaluationVersion:
    """A ground truth and a metric version."""

    truth_id: str
    metric: str


def in_force(session: Session, phase_id: str, at_ns: int | None = None) -> Activation | None:
    """Return the newest activation (up to `at_ns` inclusive, if given), or None before the first."""
    query = select(Activation).where(Activation.phase_id == phase_id)
    if at_ns is not None:
        query = query.where(Activation.activated_ns <= at_ns)
    return session.scalars(query.order_by(Activation.activated_ns.desc(), Activation.id.desc()).limit(1)).first()


def active(session: Session, phase_id: str, at_ns: int | None = None) -> EvaluationVersion | None:
    """Return the evaluation version that the board shows, or showed at `at_ns`; None if no ground truth was ready."""
    activation = in_force(session, phase_id, at_ns)
    return EvaluationVersion(activation.truth_id, activation.metric) if activation else None


def pending(session: Session, phase_id: str) -> tuple[EvaluationVersion, ...]:
    """Return the evaluation versions of pending re-scores, oldest first, without duplicates."""
    query = select(Rescore.truth_id, Rescore.metric).where(
        Rescore.phase_id == phase_id, Rescore.activated_ns.is_(None), Rescore.abandoned_ns.is_(None)
    )
    return tuple(dict.fromkeys(EvaluationVersion(*row) for row in session.execute(query.order_by(Rescore.id))))


def versions_to_score(session: Session, phase_id: str) -> tuple[EvaluationVersion, ...]:
    """Return the versions to score a new submission by: the active one, then pending ones; none before a ground truth.

    Scoring for the pending versions leaves nothing to catch up when one of them is activated.
    """
    first = active(session, phase_id)
    return tuple(dict.fromkeys((*((first,) if first else ()), *pending(session, phase_id))))
