"""Restarts of runs: a run that another version of the code started ends, and an equal request replaces it.

**Conventions.** One label set is made by one version of the code, so a partial run of another version is useless. Locks
are taken as in `services/domain/sequences/processing.py`: the sequence first, then the run. A run that is restarted
repeatedly, because workers of two versions are active, fails in the end.
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
RESTARTS = "restarts"  # the argument that counts a run's restarts
ARGUMENTS = (
    select(Job.arguments)
    .join(SequenceRow, SequenceRow.id == bindparam("sequence"))
    .where(Job.id == bindparam("run"), SequenceRow.deleted_ns.is_(None))
)
"""Arguments of a run whose sequence exists: every job starts by reading them, so this is a single statement."""


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
    """Return the arguments of the attempt's run, which this version of the code started.

    Raises `JobCancelledError` if its sequence was deleted, or if another version started the run, which is then
    restarted; `code_changed` if it cannot be restarted; and what `start_processing` raises.
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
    """Cancel this run and return the run that replaces it.

    None if nothing needs a restart: the run has ended or is being cancelled, or its sequence was deleted. If jobs call
    it concurrently, only one starts a run. Raises `RestartedTooOftenError`, and what `start_processing` raises.
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
    if new.state not in TERMINAL:  # otherwise these labels existed already
        new.arguments = {**new.arguments, RESTARTS: restarts}
    return new
