"""The check that a job's sequence still exists."""

from sqlalchemy.orm import Session

from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.specs import Attempt
from services.runtime.orm import SequenceRow


def require_sequence(session: Session, attempt: Attempt) -> SequenceRow:
    """Return the attempt's sequence. Raises `JobCancelledError` if it was deleted."""
    sequence = session.get(SequenceRow, attempt.sequence_id) if attempt.sequence_id else None
    if sequence is None or sequence.deleted_ns is not None:
        raise sequence_gone()
    return sequence


def sequence_gone() -> JobCancelledError:
    """Return the error that ends the jobs of a deleted sequence."""
    return JobCancelledError("its sequence was deleted")
