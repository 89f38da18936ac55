"""Runs attempts of jobs: claim, call the handler, record the outcome and claim the next job with it.

**Conventions.** A wake-up is for one job. A worker that has finished a job takes the next one in the same transaction,
and takes a wake-up back for it, until its series of jobs has lasted `ROW_S`. An additional transaction is relatively
expensive for short jobs. The limit gives the worker's other queues their turn.

A `StoneError` is a refusal of the input: the job fails at once, with its code. Any other error, and a
`PlatformFaultError`, is a fault of the platform or the machine. The worker pauses a little longer each time, then the
job is queued again until its attempts are used up. Then it fails with that code, or as `internal_error` with the
exception's message. The traceback is in the attempt's log. Jobs of `RETICENT` queues have read data that their owners
may not see, so only administrators can read their error messages.
"""

import mmap
import os
import time
import traceback
from collections.abc import Callable, Mapping
from contextvars import copy_context
from dataclasses import dataclass
from threading import Event, Lock, Thread
from typing import Any

import structlog
from sqlalchemy.orm import Session

from services.runtime.database.transactions import wake_up_after_commit
from services.runtime.jobs.attempt_lines import AttemptLine, AttemptWords, JobProgress, progress_now
from services.runtime.jobs.claims import Claim, claim, start_run
from services.runtime.jobs.completion import Failure, cancelled, fail, lose, succeed
from services.runtime.jobs.errors import JobCancelledError, LostAttemptError
from services.runtime.jobs.instrumentation import instrumented
from services.runtime.jobs.lease_keeper import LeaseLine
from services.runtime.jobs.specs import BULK, RETICENT, Handlers, Outcome, queue_of
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.store.free_space import free_space, require_room
from services.runtime.store.own_names import called_as_uploaded, without_paths
from services.runtime.telemetry.tracing import StageSpans
from stone.errors import PlatformFaultError, Refused, StoneError

# The reporter of a running attempt: sends heartbeats, progress and log lines, receives cancellation. A thread takes a
# turn at most once every `progress_s` and at least once every `heartbeat_s`; the handler only writes to memory. A
# report is a compare-and-set (`leases`). An attempt without its lease (terminated, or requeued after missing
# heartbeats) ends its whole process at once, whatever library it is in, so that no zombie continues. Database errors do
# not end the thread: the attempt continues and sends the report again, and only an answered heartbeat can report the
# lost lease. If this process alone cannot reach the database for longer than a lease, another worker takes over. The
# transaction that ends the attempt writes its last report.


LONGEST_EVENT = 1000
LOST = 70  # EX_SOFTWARE: the exit code of a worker process that ended itself


class Reporter:
    """`with Reporter(platform, claim) as attempt: handler(attempt)`; the handlers' `Attempt`."""

    def __init__(self, platform: Platform, claim: Claim) -> None:
        self._platform, self._claim = platform, claim
        self._limits = platform.settings.jobs
        self._lock = Lock()
        self._lines: list[AttemptLine] = []
        self._logged = 0
        self._progress: JobProgress | None = None
        self._cancel_reason = ""
        self._is_short_of_room = False
        self._begin = self._beaten = time.monotonic()
        self._leaving = Event()
        self._line = LeaseLine(platform.database, self._limits.lease_s / 4)
        self._stages = StageSpans()
        # With this attempt's context, so that the thread's log lines belong to this attempt.
        name, in_context = f"reporter-{claim.job_id[:8]}", copy_context().run
        self._thread = Thread(target=in_context, args=(self._speak,), name=name, daemon=True)

    @property
    def job_id(self) -> str:
        return self._claim.job_id

    @property
    def root_id(self) -> str:
        return self._claim.root_id

    @property
    def sequence_id(self) -> str | None:
        return self._claim.sequence_id

    @property
    def arguments(self) -> Mapping[str, Any]:
        return self._claim.arguments

    def __enter__(self) -> "Reporter":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._fall_silent()

    def progress(self, stage: str, done: int, total: int) -> None:
        """Record the job's progress. Raises `JobCancelledError` if it must stop, `StorageFullError`."""
        self._stages.enter(stage)
        with self._lock:
            self._progress = progress_now(stage, done, total)
        self.stop_if_cancelled()
        if self._is_short_of_room:
            self.require_room()

    def stop_if_cancelled(self) -> None:
        """Raise `JobCancelledError` if the job was cancelled."""
        if self._cancel_reason:
            raise JobCancelledError(self._cancel_reason)

    def require_room(self) -> None:
        """Raise `StorageFullError` if the reserve is in use and the job writes files without a limit."""
        if queue_of(self._claim.kind) in BULK:
            require_room(self._platform.settings.root, 0, self._platform.settings.store.reserve_bytes)

    def end(self) -> None:
        """Stop reporting after the handler; the transaction that records the end writes the last report."""
        self._stages.enter("")
        self._fall_silent()

    def last_words(self) -> AttemptWords:
        """Return the report that is not written yet; the same until the attempt's end is recorded."""
        return self._words()

    def rest(self) -> None:
        """Pause after a fault of the machine, twice as long each time, unless no try is left.

        Raises `JobCancelledError` if the job must stop.
        """
        if self._claim.tries_left <= 0:
            return
        until_s = time.monotonic() + self._limits.rest_s * 2 ** (self._claim.attempt - 1)
        while time.monotonic() < until_s:
            self.stop_if_cancelled()
            time.sleep(min(0.1, self._limits.rest_s))

    def log(self, event: str, level: str = "info", **facts: Any) -> None:
        """Store a line; beyond the limit of lines per attempt, the last line reports the omission."""
        with self._lock:
            self._logged += 1
            limit = self._limits.log_lines_per_attempt
            if self._logged == limit:
                event, level, facts = f"more than {limit} lines; the rest is discarded", "warning", {}
            if self._logged <= limit:
                shown = {name: without_paths(fact) if isinstance(fact, str) else fact for name, fact in facts.items()}
                event = without_paths(event)[:LONGEST_EVENT]
                self._lines.append(AttemptLine(self._logged - 1, level, event, shown, now_ns()))

    def _speak(self) -> None:
        while not self._leaving.wait(self._limits.progress_s):
            try:
                self._take_turn()
            except Exception as error:  # this thread holds the lease: it continues after any error
                self._warn("a progress report failed; the job continues", error)

    def _fall_silent(self) -> None:
        self._leaving.set()
        self._line.interrupt()
        self._thread.join()
        self._line.close()

    def _take_turn(self) -> None:
        is_due = time.monotonic() - self._beaten >= self._limits.heartbeat_s
        if is_due or self._progress or self._lines:
            self._speak_once()
        if time.monotonic() - self._begin > self._limits.time_limit_s:
            self._time_out()

    def _speak_once(self) -> None:
        words = self._words()
        try:
            answer = self._line.renew(words)
        except EOFError:  # interrupted: the end writes the last report
            return
        except Exception as error:
            self._warn("heartbeat not written; the job continues", error)
            return
        if not answer.is_held:
            self._end_process("attempt lost")
            return
        self._beaten = time.monotonic()
        self._cancel_reason = answer.cancel_reason
        space = free_space(self._platform.settings.root, self._platform.settings.store.reserve_bytes)
        self._is_short_of_room = space.free_bytes < space.reserve_bytes // 2  # a started job may use half
        if answer.is_written:
            self._forget(words)

    def _words(self) -> AttemptWords:
        with self._lock:
            return AttemptWords(self.job_id, self._claim.attempt, self._progress, tuple(self._lines))

    def _forget(self, written: AttemptWords) -> None:
        """Drop the written part of the report; newer parts stay."""
        with self._lock:
            del self._lines[: len(written.lines)]
            if self._progress is written.progress:
                self._progress = None

    def _time_out(self) -> None:
        """End an attempt after its time limit. Raises what the database raises; the next turn tries again."""
        limit_s = self._limits.time_limit_s
        sentence = (
            f"ran longer than {limit_s:.0f} s and was stopped; stages normally take minutes: is the input unusual?"
        )
        with self._platform.database.transaction() as session:
            fail(session, self._claim, Failure("time_limit", sentence))
        self._end_process("time limit")

    def _warn(self, event: str, error: Exception) -> None:
        log.warning(event, job_id=self.job_id, reason=f"{type(error).__name__}: {error}"[:500])

    def _end_process(self, reason: str) -> None:
        """End the process, because the handler may be in a library that cannot be interrupted."""
        log.warning("process ends itself", job_id=self.job_id, attempt=self._claim.attempt, reason=reason)
        os._exit(LOST)


ROW_S = 2.0

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class JobRow:
    """Jobs of `queue` that one process runs in series while `goes_on()`, until `until_s` (monotonic)."""

    platform: Platform
    queue: str
    handlers: Handlers
    goes_on: Callable[[], bool]
    until_s: float

    def first(self) -> Claim | None:
        with self.platform.database.transaction() as session:
            return claim(session, self.queue)

    def following(self, session: Session) -> Claim | None:
        """Return the next job, claimed in the transaction that ends the previous one."""
        if time.monotonic() > self.until_s or not self.goes_on():
            return None
        if (taken := claim(session, self.queue)) is not None:
            wake_up_after_commit(session, self.queue, -1)
        return taken


@dataclass(frozen=True)
class AttemptEnd:
    """The end of an attempt, with the code of its failure; `following` is the next claimed job."""

    outcome: str
    code: str = ""
    following: Claim | None = None


def run_next(platform: Platform, queue: str, handlers: Handlers) -> bool:
    """Run the next ready job of `queue`; return False if there was none (another worker took it)."""
    return run_row(platform, queue, handlers, lambda: False) > 0


def run_row(platform: Platform, queue: str, handlers: Handlers, goes_on: Callable[[], bool]) -> int:
    """Run ready jobs of `queue` in series while `goes_on()`; return the number of attempts."""
    row, attempts = JobRow(platform, queue, handlers, goes_on, time.monotonic() + ROW_S), 0
    taken = row.first()
    while taken is not None:
        attempts += 1
        taken = _run(row, taken)
    return attempts


def _run(row: JobRow, taken: Claim) -> Claim | None:
    """Run the attempt; return the next claimed job, if any."""
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
        log.warning("attempt raised", code=getattr(error, "code", "internal_error"), reason=str(error)[:LONGEST_EVENT])
        failure = _failure_of(row.platform, error, taken)
        if is_refusal(error):
            _fail(row.platform, taken, reporter, failure)
            return AttemptEnd("failed", failure.code)
        with row.platform.database.transaction() as session:
            lose(session, taken, failure, reporter.last_words())
        return AttemptEnd("lost", failure.code)


def _answer(taken: Claim, handlers: Handlers, reporter: Reporter) -> Outcome:
    """Return the handler's outcome. Raises what it raises, `unknown_kind`, `JobCancelledError`."""
    try:
        if taken.kind not in handlers:
            raise Refused(
                "unknown_kind",
                f"this worker has no stage {taken.kind!r}; its stages are {sorted(handlers)} (do all services have "
                "the same version?)",
            )
        reporter.require_room()
        outcome = handlers[taken.kind](reporter)
        reporter.stop_if_cancelled()
        return outcome
    except Exception as error:
        if not is_refusal(error):
            reporter.log("the stage raised", "error", traceback=traceback.format_exc()[-8000:])
            reporter.rest()
        raise
    finally:
        reporter.end()


def is_refusal(error: Exception) -> bool:
    """Return whether a retry is useless: the input is refused, or the job must stop."""
    return isinstance(error, StoneError) and not isinstance(error, PlatformFaultError)


def _failure_of(platform: Platform, error: Exception, taken: Claim) -> Failure:
    """Return the failure for the job's owner: the error's message, unless it could quote hidden data."""
    is_said = isinstance(error, StoneError) or queue_of(taken.kind) not in RETICENT
    words = str(error) if is_said else "the attempt's log has the message"
    with platform.database.reading() as session:
        words = called_as_uploaded(session, taken.job_id, words)
    if isinstance(error, StoneError):
        return Failure(error.code, words)
    return Failure("internal_error", f"{type(error).__name__}: {words}")


def _succeed(row: JobRow, taken: Claim, outcome: Outcome, reporter: Reporter) -> Claim | None:
    """Record the success and claim the next job with it.

    Raises `LostAttemptError` if the lease was lost meanwhile; nothing is written then.
    """
    with row.platform.database.transaction() as session:
        if not succeed(session, taken, outcome, row.platform.settings.jobs.max_attempts, reporter.last_words()):
            raise LostAttemptError(taken.job_id, taken.attempt)
        return row.following(session)


def _fail(platform: Platform, taken: Claim, reporter: Reporter, failure: Failure) -> None:
    reporter.log(failure.sentence, "error", code=failure.code)
    with platform.database.transaction() as session:
        fail(session, taken, failure, reporter.last_words())


# Whether this worker must stop: set once by its parent, visible to every process of its pool. One byte of memory is
# shared with all processes forked after this module was imported. It is never reset.


_STOP = mmap.mmap(-1, 1)


def stop_claiming() -> None:
    """Make all processes of this worker stop claiming jobs."""
    _STOP[0] = 1


def takes_jobs() -> bool:
    return _STOP[0] == 0
