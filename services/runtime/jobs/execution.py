"""Runs one attempt at a job: claim, call its handler, record the outcome.

**Conventions.** A `StoneError` is a refusal of the input: the job fails at once, with its code. Anything else, and a
`PlatformFaultError`, is a fault of ours or of the machine: the worker rests a little longer each time, then the job is
queued again until its attempts are used up; then it fails with that code, or as `internal_error` with the exception's
own words. The traceback is in the attempt's log. Jobs of `RETICENT` queues have seen what their owners may not: of what
raises there, administrators alone read the words.
"""

import traceback

import structlog

from services.runtime.jobs.claims import Claim, claim, start_run
from services.runtime.jobs.completion import Failure, cancelled, fail, lose, succeed
from services.runtime.jobs.errors import JobCancelledError, LostAttemptError, UnknownKindError
from services.runtime.jobs.instrumentation import instrumented, origin_of
from services.runtime.jobs.reporter import Reporter
from services.runtime.jobs.specs import RETICENT, Handlers, Outcome, queue_of
from services.runtime.platform import Platform
from stone.errors import PlatformFaultError, StoneError

log = structlog.get_logger(__name__)


def run_next(platform: Platform, queue: str, handlers: Handlers) -> bool:
    """Run the next ready job of `queue` to its end; False when there was none (another worker took it)."""
    with platform.database.transaction() as session:
        taken = claim(session, queue)
    if taken is None:
        return False
    with platform.database.transaction() as session:
        start_run(session, taken)
        origin = origin_of(session, taken)
    with instrumented(taken, origin) as instrumentation, Reporter(platform, taken) as reporter:
        instrumentation.ended(*_attempt(platform, taken, handlers, reporter))
        log.info("attempt ended", outcome=instrumentation.outcome)
    return True


def _attempt(platform: Platform, taken: Claim, handlers: Handlers, reporter: Reporter) -> tuple[str, str]:
    """Run the attempt; returns its outcome and the code of its failure."""
    try:
        _succeed(platform, taken, _answer(taken, handlers, reporter), reporter)
    except LostAttemptError as error:
        log.warning("attempt lost", reason=str(error))
        return "lost", error.code
    except JobCancelledError as error:
        reporter.log(str(error), "warning")
        with platform.database.transaction() as session:
            cancelled(session, taken, reporter.last_words())
        return "cancelled", error.code
    except Exception as error:
        failure = _failure_of(error, taken.kind)
        if is_refusal(error):
            _fail(platform, taken, reporter, failure)
            return "failed", failure.code
        with platform.database.transaction() as session:
            lose(session, taken, failure, reporter.last_words())
        return "lost", failure.code
    return "succeeded", ""


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


def _succeed(platform: Platform, taken: Claim, outcome: Outcome, reporter: Reporter) -> None:
    """Raises `LostAttemptError` when the job went to somebody else meanwhile; nothing is written then."""
    with platform.database.transaction() as session:
        if not succeed(session, taken, outcome, platform.settings.jobs.max_attempts, reporter.last_words()):
            raise LostAttemptError(taken.job_id, taken.attempt)


def _fail(platform: Platform, taken: Claim, reporter: Reporter, failure: Failure) -> None:
    reporter.log(failure.sentence, "error", code=failure.code)
    with platform.database.transaction() as session:
        fail(session, taken, failure, reporter.last_words())
