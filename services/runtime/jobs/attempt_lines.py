"""Log lines of an attempt as rows, each written once even if sent repeatedly.

**Conventions.** A line is numbered when it is logged, and (job, attempt, number) is its key. After a commit whose
answer was lost, the same lines are sent again, and existing rows stay unchanged.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from sqlalchemy.exc import InterfaceError, OperationalError, TimeoutError
from sqlalchemy.orm import Session

from services.runtime.database.inserts import insert_new
from services.runtime.orm import JobLine
from services.runtime.orm.base import now_ns

# Reports of a running attempt: progress and log lines.


LONGEST_STAGE = 64
INTEGERS = range(-(2**31), 2**31)
AttemptKey = tuple[str, int]


@dataclass(frozen=True)
class JobProgress:
    """`done` of `total` in a stage, as reported at `told_ns`."""

    stage: str
    done: int
    total: int
    told_ns: int

    @property
    def fits(self) -> bool:
        """Return whether the columns accept it, since a sandboxed child may report any value."""
        return _is_text(self.stage, LONGEST_STAGE) and self.done in INTEGERS and self.total in INTEGERS

    def columns(self) -> dict[str, Any]:
        """Return the columns of the job's row."""
        return {"stage": self.stage, "done": self.done, "total": self.total, "progress_ns": self.told_ns}


@dataclass(frozen=True)
class AttemptLine:
    """One log line; `number` counts from 0 within its attempt."""

    number: int
    level: str
    event: str
    facts: dict[str, Any]
    logged_ns: int


@dataclass(frozen=True)
class AttemptWords:
    """The report of attempt `attempt` of a job in one turn, which is also a heartbeat."""

    job_id: str
    attempt: int
    progress: JobProgress | None = None
    lines: tuple[AttemptLine, ...] = ()

    @property
    def key(self) -> AttemptKey:
        return self.job_id, self.attempt

    def columns(self) -> dict[str, Any]:
        """Return the changed columns of the job's row; empty without valid progress."""
        return self.progress.columns() if self.progress and self.progress.fits else {}


def progress_now(stage: str, done: int, total: int) -> JobProgress:
    return JobProgress(stage, done, total, now_ns())


def _is_text(text: str, longest: int) -> bool:
    return (
        len(text) <= longest and "\x00" not in text and not any("\ud800" <= character <= "\udfff" for character in text)
    )


AT_A_TIME = 500
LONGEST_PLAIN = 900
LONGEST_LEVEL = 8
OUTAGES = (OperationalError, InterfaceError, TimeoutError)
"""Errors without an answer from the database in time: the same statement may succeed next time.

Other errors are caused by the values (an oversized number, an invalid character) and recur.
"""


def write_lines(session: Session, words: Sequence[AttemptWords]) -> None:
    """Insert the lines of several attempts that are not stored yet."""
    rows = [_row(report, line) for report in words for line in report.lines]
    for first in range(0, len(rows), AT_A_TIME):
        insert_new(session, JobLine, rows[first : first + AT_A_TIME])


def write_lines_singly(session: Session, words: AttemptWords) -> None:
    """Insert lines one by one after the database rejected one; its row then contains the error instead."""
    for line in words.lines:
        try:
            with session.begin_nested():
                insert_new(session, JobLine, [_row(words, line)])
        except OUTAGES:
            raise
        except Exception as error:
            kept = AttemptLine(line.number, "warning", _unkept(error), {}, line.logged_ns)
            insert_new(session, JobLine, [_row(words, kept)])


def write_lines_beside(session: Session, words: AttemptWords) -> None:
    """Insert lines as `write_lines` within another transaction, which no line may make fail."""
    if all(_is_plain(line) for line in words.lines):
        write_lines(session, [words])
        return
    try:
        with session.begin_nested():
            write_lines(session, [words])
    except OUTAGES:
        raise
    except Exception:
        write_lines_singly(session, words)


def _is_plain(line: AttemptLine) -> bool:
    """Return whether every database accepts the line: short, ASCII without control characters, finite numbers."""
    try:
        text = json.dumps([line.level, line.event, line.facts], allow_nan=False)
    except (TypeError, ValueError, RecursionError):
        return False
    return len(text) <= LONGEST_PLAIN and len(line.level) <= LONGEST_LEVEL and "\\" not in text


def _row(words: AttemptWords, line: AttemptLine) -> dict[str, Any]:
    return {"job_id": words.job_id, "attempt": words.attempt, **asdict(line)}


def _unkept(error: Exception) -> str:
    return f"this line cannot be stored: the database rejected it ({type(error).__name__})"
