"""Files that stages of a run leave for others in its workspace: names, and the check that they are there.

**Conventions.** `checked.npz` is `sequence.npz` with what the late checks found among its findings: it is made while
the sequence is labelled, and is what is published under the name of the other. Of several recordings the `joined.json`
that describes them (`stone_files.joined_file`) lies beside these and is published with the labels: what is made later
opens the recordings with the offsets of those labels.
"""

from collections.abc import Iterable
from pathlib import Path

from sqlalchemy.orm import Session

from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.specs import Attempt
from services.runtime.orm import SequenceRow
from stone.errors import Refused

SEQUENCE_FILE = "sequence.npz"
CHECKED_FILE = "checked.npz"
SWEEPS_FILE = "sweeps.npz"


def require_left(folder: Path, names: Iterable[str]) -> None:
    """Raises `work_gone` for the first of these files or folders that is not there."""
    for name in names:
        if not (folder / name).exists():
            raise Refused(
                "work_gone", f"{name} of this run is gone, so it cannot be continued; process the sequence again"
            )


# The check that a job's sequence still exists.


def require_sequence(session: Session, attempt: Attempt) -> SequenceRow:
    """The sequence the attempt works for. Raises `JobCancelledError` when it was deleted."""
    sequence = session.get(SequenceRow, attempt.sequence_id) if attempt.sequence_id else None
    if sequence is None or sequence.deleted_ns is not None:
        raise sequence_gone()
    return sequence


def sequence_gone() -> JobCancelledError:
    """What ends the jobs of a sequence that was deleted."""
    return JobCancelledError("its sequence was deleted")
