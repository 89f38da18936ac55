"""What every stage does: find out whether its sequence still stands, and say what it cost."""

import resource
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
    """The stage, whose job's result also says how much processor time it took: `cpu_s`, of this process
    and the children it has waited for."""

    def run(platform: Platform, attempt: Attempt) -> Outcome:
        begin_s = _cpu_s()
        outcome = stage(platform, attempt)
        return replace(outcome, result={**outcome.result, "cpu_s": round(_cpu_s() - begin_s, 3)})

    return run


def _cpu_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)
