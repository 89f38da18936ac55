"""Restarts of runs: a run that another version of the code began ends, and one of the same request takes its place.

**Conventions.** One label set is made by one version of the code, so half a run of another is of no use. Locks are
taken as `services/domain/sequences/processing.py` takes them: the sequence first, then the run. A run that is begun
again and again, because workers of two versions serve at once, fails in the end.
"""

from typing import Any

from sqlalchemy import bindparam, select
from sqlalchemy.orm import Session

from services.domain.sequences.processing import lock_sequence, request_of, start_processing
from services.domain.sequences.processing_errors import (
    AlreadyProcessingError,
    RecordingPendingError,
    SequenceDeletedError,
)
from services.domain.sequences.stage_checks import sequence_gone
from services.runtime.code_version import code_version
from services.runtime.jobs.changes import lock_run
from services.runtime.jobs.control import terminate
from services.runtime.jobs.errors import JobCancelledError, QueueDrainingError
from services.runtime.jobs.specs import TERMINAL, Attempt
from services.runtime.orm import Job, SequenceRow
from services.runtime.platform import Platform
from stone.errors import Refused, StoneError

MOST_RESTARTS = 10
RESTARTS = "restarts"  # the argument of a run that counts them
ARGUMENTS = (
    select(Job.arguments)
    .join(SequenceRow, SequenceRow.id == bindparam("sequence"))
    .where(Job.id == bindparam("run"), SequenceRow.deleted_ns.is_(None))
)
"""The arguments of a run, while its sequence is there: every job of it begins with them, so they are one statement."""


class RestartedTooOftenError(StoneError):
    """Workers of two code versions keep restarting the run."""

    code = "restarted_too_often"

    def __init__(self, restarts: int) -> None:
        super().__init__(f"the run was already restarted {restarts} times; do all workers run the same version?")


def code_changed(versions: tuple[str, str], why: StoneError, remedy: str = "Process the sequence again") -> Refused:
    begun, ours = versions
    return Refused(
        "code_changed",
        f"this run was started by code version {begun} and this worker runs {ours}; the run could not be restarted: "
        f"{why}. {remedy}",
    )


NOT_NOW = (QueueDrainingError, RecordingPendingError, AlreadyProcessingError, RestartedTooOftenError)


def arguments_of_run(platform: Platform, attempt: Attempt) -> dict[str, Any]:
    """The arguments of the attempt's run, which this version of the code began.

    Raises `JobCancelledError` where its sequence was deleted, or where another version did, once the run is begun
    again; `code_changed` where that is not possible now; and what `start_processing` raises where it is refused.
    """
    with platform.database.lookups() as session:
        arguments = session.scalar(ARGUMENTS, {"run": attempt.root_id, "sequence": attempt.sequence_id})
    if arguments is None:
        raise sequence_gone()
    begun = arguments["code_version"]
    if begun == code_version("labels"):
        return arguments
    try:
        with platform.database.transaction() as session:
            begin_again(session, attempt.root_id)
            reason = session.get_one(Job, attempt.root_id).cancel_reason
    except NOT_NOW as error:
        raise code_changed((begun, code_version("labels")), error) from error
    raise JobCancelledError(reason or f"its run was started by version {begun} and has ended")


def begin_again(session: Session, root_id: str) -> Job | None:
    """The run that takes this one's place; this one ends cancelled.

    None where there is nothing to begin again: the run has ended or is to stop, or its sequence was deleted. So of jobs
    that ask at once, one begins a run. Raises `RestartedTooOftenError`, and what `start_processing` raises.
    """
    try:
        sequence = lock_sequence(session, session.get_one(Job, root_id).sequence_id or "")
    except SequenceDeletedError:
        return None
    old = lock_run(session, root_id)
    if old.state in TERMINAL or old.cancel_reason:
        return None
    restarts = old.arguments.get(RESTARTS, 0) + 1
    if restarts > MOST_RESTARTS:
        raise RestartedTooOftenError(MOST_RESTARTS)
    upgraded = f"the platform was upgraded to code version {code_version('labels')}"
    terminate(session, root_id, upgraded)
    new = start_processing(session, sequence, request_of(old.arguments))
    old.cancel_reason = f"{upgraded}; job {new.id} processes the sequence instead"
    if new.state not in TERMINAL:  # else these labels were made already
        new.arguments = {**new.arguments, RESTARTS: restarts}
    return new
