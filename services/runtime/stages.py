"""What every stage does first: find out whether its sequence still stands."""

from sqlalchemy.orm import Session

from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.specs import Attempt
from services.runtime.orm import Sequence


def standing_sequence(session: Session, attempt: Attempt) -> Sequence:
    """The sequence the attempt works for. Raises `JobCancelledError` when it was deleted."""
    sequence = session.get(Sequence, attempt.sequence_id) if attempt.sequence_id else None
    if sequence is None or sequence.deleted_ns is not None:
        raise JobCancelledError("its sequence was deleted")
    return sequence
