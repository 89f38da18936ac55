"""The reporter of a running attempt: sends heartbeats, progress and log lines, receives cancellation.

**Conventions.** A thread writes at most once every `progress_s` and at least once every `heartbeat_s`; the handler only
touches memory. Writing is a compare-and-set: an attempt that no longer holds its job (terminated, or taken over after
silence) ends its whole process at once, whatever library it is in, so that no zombie works on. A heartbeat is a
transaction of its own, so that nothing else that is to be written can make it fail. No error of the database ends the
thread: the attempt goes on in silence and tries again, and only a heartbeat that was answered says that the job is held
no more. If the database stays away from this process alone for longer than a lease, another worker takes over.
"""

import os
import time
from collections.abc import Mapping
from contextvars import copy_context
from threading import Event, Lock, Thread
from typing import Any

import structlog
from sqlalchemy import select, update
from sqlalchemy.orm import Session

from services.runtime.jobs.attempt_lines import OUTAGES, AttemptLine, write_lines, write_lines_singly
from services.runtime.jobs.changes import rows_changed
from services.runtime.jobs.claims import Claim
from services.runtime.jobs.completion import Failure, fail
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.orm import Job
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
        self._progress: tuple[str, int, int] | None = None
        self._cancel_reason = ""
        self._begin = self._beaten = time.monotonic()
        self._is_ending = False
        self._leaving = Event()
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
        self._flush(is_last=True)

    def progress(self, stage: str, done: int, total: int) -> None:
        """Note how far the job is. Raises `JobCancelledError` when it is to stop."""
        self._stages.enter(stage)
        with self._lock:
            self._progress = (stage, done, total)
        self.stop_if_asked()

    def stop_if_asked(self) -> None:
        """Raises `JobCancelledError` when somebody asked the job to stop."""
        if self._cancel_reason:
            raise JobCancelledError(self._cancel_reason)

    def end(self) -> None:
        """The handler is through: write its last words while the job is still held, then fall silent.

        That the job is held no more is from now on found by whoever records the end.
        """
        self._is_ending = True
        self._stages.enter("")
        self._leaving.set()
        self._thread.join()
        self._flush(is_last=False)

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

    def _take_turn(self) -> None:
        is_due = time.monotonic() - self._beaten >= self._limits.heartbeat_s
        if is_due or self._progress or self._lines:
            self._flush(is_last=False)
        if time.monotonic() - self._begin > self._limits.time_limit_s:
            self._time_out()

    def _flush(self, *, is_last: bool) -> None:
        """Beat, then write the lines; the last time there is no job to hold any more."""
        if is_last:
            self._write_lines()
        elif (is_ours := self._beat()) is not None:
            self._write_lines()
            if not is_ours:
                self._end_process("attempt lost")

    def _beat(self) -> bool | None:
        """Whether the job is still ours; None where the database did not say."""
        with self._lock:
            progress, self._progress = self._progress, None
        for told in (progress, None):  # the second time without what no column takes: a heartbeat needs no words
            try:
                with self._platform.database.transaction() as session:
                    is_ours = self._renew(session, told)
            except OUTAGES as error:
                self._warn("heartbeat not written; the job goes on", error)
                self._keep(told)
                return None
            except Exception as error:
                self._warn("progress not written", error)
                continue
            self._beaten = time.monotonic()
            return is_ours
        return None

    def _keep(self, told: tuple[str, int, int] | None) -> None:
        """What was not written is told the next time, unless there is newer progress by then."""
        with self._lock:
            if self._progress is None:
                self._progress = told

    def _renew(self, session: Session, progress: tuple[str, int, int] | None) -> bool:
        held = update(Job).where(Job.id == self.job_id, Job.attempt == self._claim.attempt, Job.state == "running")
        values: dict[str, Any] = {"heartbeats": Job.heartbeats + 1}
        if progress:
            stage, done, total = progress
            values |= {"stage": stage, "done": done, "total": total, "progress_ns": now_ns()}
            values["revision"] = Job.revision + 1
        if not rows_changed(session, held.values(**values)):
            return self._is_ending
        own_or_run = select(Job.cancel_reason).where(Job.id.in_((self.job_id, self.root_id)), Job.cancel_reason != "")
        self._cancel_reason = session.scalar(own_or_run) or ""
        return True

    def _write_lines(self) -> None:
        with self._lock:
            lines, self._lines = self._lines, []
        for write in (write_lines, write_lines_singly):
            if not lines:
                return
            try:
                with self._platform.database.transaction() as session:
                    write(session, self._claim, lines)
                return
            except Exception as error:
                self._warn("log lines not written; the job goes on", error)
                if isinstance(error, OUTAGES):
                    break
        with self._lock:
            self._lines = lines + self._lines

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
