"""The reporter of a running attempt: sends heartbeats, progress and log lines, receives cancellation.

**Conventions.** A thread takes a turn at most once every `progress_s` and at least once every `heartbeat_s`; the
handler only touches memory. What is said in a turn is a compare-and-set (`leases`): an attempt that no longer holds its
job (terminated, or taken over after silence) ends its whole process at once, whatever library it is in, so that no
zombie works on. No error of the database ends the thread: the attempt goes on in silence and says it all again, and
only a heartbeat that was answered says that the job is held no more. If the database stays away from this process alone
for longer than a lease, another worker takes over. The last words are written by the transaction that ends the attempt.
"""

import os
import time
from collections.abc import Mapping
from contextvars import copy_context
from threading import Event, Lock, Thread
from typing import Any

import structlog

from services.runtime.jobs.attempt_words import AttemptLine, AttemptWords, JobProgress, progress_now
from services.runtime.jobs.claims import Claim
from services.runtime.jobs.completion import Failure, fail
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.lease_line import LeaseLine
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.telemetry.stage_spans import StageSpans

LONGEST_EVENT = 1000
LOST = 70  # EX_SOFTWARE: the exit code of a worker process that ended itself

log = structlog.get_logger(__name__)


class Reporter:
    """`with Reporter(platform, claim) as attempt: handler(attempt)`; the `Attempt` that handlers see."""

    def __init__(self, platform: Platform, claim: Claim) -> None:
        self._platform, self._claim = platform, claim
        self._limits = platform.settings.jobs
        self._lock = Lock()
        self._lines: list[AttemptLine] = []
        self._logged = 0
        self._progress: JobProgress | None = None
        self._cancel_reason = ""
        self._begin = self._beaten = time.monotonic()
        self._leaving = Event()
        self._line = LeaseLine(platform.database, self._limits.lease_s / 4)
        self._stages = StageSpans()
        # With this attempt's context, so that what the thread says is told as this attempt's too.
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
        """Note how far the job is. Raises `JobCancelledError` when it is to stop."""
        self._stages.enter(stage)
        with self._lock:
            self._progress = progress_now(stage, done, total)
        self.stop_if_asked()

    def stop_if_asked(self) -> None:
        """Raises `JobCancelledError` when somebody asked the job to stop."""
        if self._cancel_reason:
            raise JobCancelledError(self._cancel_reason)

    def end(self) -> None:
        """The handler is through: fall silent. Whoever records the end writes the last words with it."""
        self._stages.enter("")
        self._fall_silent()

    def last_words(self) -> AttemptWords:
        """What was not written yet; the same again until the attempt's end is recorded."""
        return self._words()

    def rest(self) -> None:
        """Wait before a fault of the machine is met again, twice as long each time; not where no try is left.

        Raises `JobCancelledError` when the job is to stop.
        """
        if self._claim.tries_left <= 0:
            return
        until_s = time.monotonic() + self._limits.rest_s * 2 ** (self._claim.attempt - 1)
        while time.monotonic() < until_s:
            self.stop_if_asked()
            time.sleep(min(0.1, self._limits.rest_s))

    def log(self, event: str, level: str = "info", **facts: Any) -> None:
        """Keep a line; beyond the limit of lines per attempt the last one says that there were more."""
        with self._lock:
            self._logged += 1
            limit = self._limits.log_lines_per_attempt
            if self._logged == limit:
                event, level, facts = f"more than {limit} lines; the rest is not kept", "warning", {}
            if self._logged <= limit:
                self._lines.append(AttemptLine(self._logged - 1, level, event[:LONGEST_EVENT], facts, now_ns()))

    def _speak(self) -> None:
        while not self._leaving.wait(self._limits.progress_s):
            try:
                self._take_turn()
            except Exception as error:  # this thread is what holds the job: it goes on, whatever is raised
                self._warn("a turn of the reporter failed; the job goes on", error)

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
        except EOFError:  # it ends, and says its last words with its end
            return
        except Exception as error:
            self._warn("heartbeat not written; the job goes on", error)
            return
        if not answer.is_held:
            self._end_process("attempt lost")
            return
        self._beaten = time.monotonic()
        self._cancel_reason = answer.cancel_reason
        if answer.is_written:
            self._forget(words)

    def _words(self) -> AttemptWords:
        with self._lock:
            return AttemptWords(self.job_id, self._claim.attempt, self._progress, tuple(self._lines))

    def _forget(self, written: AttemptWords) -> None:
        """What is written is not said again; newer words stay."""
        with self._lock:
            del self._lines[: len(written.lines)]
            if self._progress is written.progress:
                self._progress = None

    def _time_out(self) -> None:
        """Raises what the database raises; the next turn tries again."""
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
        """The handler may be inside a library that hears nothing; a process that ends stops surely."""
        log.warning("process ends itself", job_id=self.job_id, attempt=self._claim.attempt, reason=reason)
        os._exit(LOST)
