"""Runs attempts at jobs: claim, call the handler, record the outcome and claim the next job with it.

**Conventions.** A wake-up is for one job. Whoever has done it takes the next one in the transaction that ends it, and
takes a wake-up back for that, as long as its row of jobs has lasted less than `ROW_S`: a transaction more weighs most
for short jobs, and other queues of the same worker have their turn after it.

A `StoneError` is a refusal of the input: the job fails at once, with its code. Anything else, and a
`PlatformFaultError`, is a fault of ours or of the machine: the worker rests a little longer each time, then the job is
queued again until its attempts are used up; then it fails with that code, or as `internal_error` with the exception's
own words. The traceback is in the attempt's log. Jobs of `RETICENT` queues have seen what their owners may not: of what
raises there, administrators alone read the words.
"""

import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass

import structlog
from sqlalchemy.orm import Session

from services.runtime.database.transactions import wake_up_after_commit
from services.runtime.jobs.claims import Claim, claim, start_run
from services.runtime.jobs.completion import Failure, cancelled, fail, lose, succeed
from services.runtime.jobs.errors import JobCancelledError, LostAttemptError, UnknownKindError
from services.runtime.jobs.instrumentation import instrumented
from services.runtime.jobs.reporter import Reporter
from services.runtime.jobs.specs import RETICENT, Handlers, Outcome, queue_of
from services.runtime.platform import Platform
from stone.errors import PlatformFaultError, StoneError

ROW_S = 2.0

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class JobRow:
    """Jobs of `queue` that one process runs one after another while `goes_on()`, until `until_s` (monotonic)."""

    platform: Platform
    queue: str
    handlers: Handlers
    goes_on: Callable[[], bool]
    until_s: float

    def first(self) -> Claim | None:
        with self.platform.database.transaction() as session:
            return claim(session, self.queue)

    def following(self, session: Session) -> Claim | None:
        """The next one, taken in the transaction that ends the one before."""
        if time.monotonic() > self.until_s or not self.goes_on():
            return None
        if (taken := claim(session, self.queue)) is not None:
            wake_up_after_commit(session, self.queue, -1)
        return taken


@dataclass(frozen=True)
class AttemptEnd:
    """How an attempt ended, with the code of its failure; `following` is what its success took."""

    outcome: str
    code: str = ""
    following: Claim | None = None


def run_next(platform: Platform, queue: str, handlers: Handlers) -> bool:
    """Run the next ready job of `queue` to its end; False when there was none (another worker took it)."""
    return run_row(platform, queue, handlers, lambda: False) > 0


def run_row(platform: Platform, queue: str, handlers: Handlers, goes_on: Callable[[], bool]) -> int:
    """Run the next ready job of `queue`, then the next one and so on while `goes_on()`; how many attempts it were."""
    row, attempts = JobRow(platform, queue, handlers, goes_on, time.monotonic() + ROW_S), 0
    taken = row.first()
    while taken is not None:
        attempts += 1
        taken = _run(row, taken)
    return attempts


def _run(row: JobRow, taken: Claim) -> Claim | None:
    """Run the attempt; the next one, where its success took it."""
    if taken.begins_run:
        with row.platform.database.transaction() as session:
            start_run(session, taken)
    with instrumented(taken) as instrumentation, Reporter(row.platform, taken) as reporter:
        end = _attempt(row, taken, reporter)
        instrumentation.ended(end.outcome, end.code)
        log.info("attempt ended", outcome=instrumentation.outcome)
    return end.following


def _attempt(row: JobRow, taken: Claim, reporter: Reporter) -> AttemptEnd:
    """Run the attempt and record its end."""
    try:
        return AttemptEnd("succeeded", following=_succeed(row, taken, _answer(taken, row.handlers, reporter), reporter))
    except LostAttemptError as error:
        log.warning("attempt lost", reason=str(error))
        return AttemptEnd("lost", error.code)
    except JobCancelledError as error:
        reporter.log(str(error), "warning")
        with row.platform.database.transaction() as session:
            cancelled(session, taken, reporter.last_words())
        return AttemptEnd("cancelled", error.code)
    except Exception as error:
        failure = _failure_of(error, taken.kind)
        if is_refusal(error):
            _fail(row.platform, taken, reporter, failure)
            return AttemptEnd("failed", failure.code)
        with row.platform.database.transaction() as session:
            lose(session, taken, failure, reporter.last_words())
        return AttemptEnd("lost", failure.code)


def _answer(taken: Claim, handlers: Handlers, reporter: Reporter) -> Outcome:
    """The handler's answer. Raises what it raises, `UnknownKindError`, `JobCancelledError`."""
    try:
        if taken.kind not in handlers:
            raise UnknownKindError(taken.kind, sorted(handlers))
        outcome = handlers[taken.kind](reporter)
        reporter.stop_if_asked()
        return outcome
    except Exception as error:
        if not is_refusal(error):
            reporter.log("the stage raised", "error", traceback=traceback.format_exc()[-8000:])
            reporter.rest()
        raise
    finally:
        reporter.end()


def is_refusal(error: Exception) -> bool:
    """Whether trying again is of no use: the input is refused, or the job is to stop."""
    return isinstance(error, StoneError) and not isinstance(error, PlatformFaultError)


def _failure_of(error: Exception, kind: str) -> Failure:
    """The failure as its owner sees it: the words of what raised, unless they might quote what is hidden from them."""
    if isinstance(error, StoneError):
        return Failure(error.code, str(error))
    words = "its words are in the log of the attempt" if queue_of(kind) in RETICENT else str(error)
    return Failure("internal_error", f"{type(error).__name__}: {words}")


def _succeed(row: JobRow, taken: Claim, outcome: Outcome, reporter: Reporter) -> Claim | None:
    """Record the success; what follows is taken with it.

    Raises `LostAttemptError` when the job went to somebody else meanwhile; nothing is written then.
    """
    with row.platform.database.transaction() as session:
        if not succeed(session, taken, outcome, row.platform.settings.jobs.max_attempts, reporter.last_words()):
            raise LostAttemptError(taken.job_id, taken.attempt)
        return row.following(session)


def _fail(platform: Platform, taken: Claim, reporter: Reporter, failure: Failure) -> None:
    reporter.log(failure.sentence, "error", code=failure.code)
    with platform.database.transaction() as session:
        fail(session, taken, failure, reporter.last_words())
