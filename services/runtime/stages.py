"""What every stage does: find out whether its sequence still stands, and say what it cost."""

import time
from collections.abc import Callable
from dataclasses import replace

from sqlalchemy.orm import Session

from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.specs import Attempt, Outcome
from services.runtime.orm import Sequence
from services.runtime.platform import Platform

Stage = Callable[[Platform, Attempt], Outcome]


def standing_sequence(session: Session, attempt: Attempt) -> Sequence:
    """The sequence the attempt works for. Raises `JobCancelledError` when it was deleted."""
    sequence = session.get(Sequence, attempt.sequence_id) if attempt.sequence_id else None
    if sequence is None or sequence.deleted_ns is not None:
        raise JobCancelledError("its sequence was deleted")
    return sequence


def measured(stage: Stage) -> Stage:
    """The stage, whose job's result also says how much processor time it took: `cpu_s`, of this process."""

    def run(platform: Platform, attempt: Attempt) -> Outcome:
        begin_s = time.process_time()
        outcome = stage(platform, attempt)
        return replace(outcome, result={**outcome.result, "cpu_s": round(time.process_time() - begin_s, 3)})

    return run
