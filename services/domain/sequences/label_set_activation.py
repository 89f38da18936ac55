"""Activation of a label set: it replaces the set that was created or activated last."""

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from services.domain.sequences.processing import lock_sequence
from services.runtime.orm import LabelSet
from services.runtime.orm.base import now_ns


def activate_label_set(session: Session, labels: LabelSet) -> None:
    """Activate the label set in the caller's transaction. Raises `SequenceDeletedError`."""
    lock_sequence(session, labels.sequence_id)
    last = select(func.max(LabelSet.chosen_ns)).where(LabelSet.sequence_id == labels.sequence_id)
    labels.chosen_ns = max(now_ns(), (session.scalar(last) or 0) + 1)
