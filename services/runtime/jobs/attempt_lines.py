"""Log lines of an attempt as rows: written once however often they are sent.

**Conventions.** A line has its number from the moment it is said, and (job, attempt, number) is its key: after a commit
whose answer was lost the same lines are sent again, and those that are there stay as they are.
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

# What a running attempt has to say: how far it is, and its log lines.


LONGEST_STAGE = 64
INTEGERS = range(-(2**31), 2**31)
AttemptKey = tuple[str, int]


@dataclass(frozen=True)
class JobProgress:
    """`done` of `total` in a stage, as it was said at `told_ns`."""

    stage: str
    done: int
    total: int
    told_ns: int

    @property
    def fits(self) -> bool:
        """Whether the columns take it: a sandboxed child says what it likes."""
        return _is_text(self.stage, LONGEST_STAGE) and self.done in INTEGERS and self.total in INTEGERS

    def columns(self) -> dict[str, Any]:
        """Of the job's row."""
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
    """What attempt `attempt` of a job says in one turn; that it says anything means that it lives."""

    job_id: str
    attempt: int
    progress: JobProgress | None = None
    lines: tuple[AttemptLine, ...] = ()

    @property
    def key(self) -> AttemptKey:
        return self.job_id, self.attempt

    def columns(self) -> dict[str, Any]:
        """What its progress changes in the job's row; nothing where there is none, or none that fits."""
        return self.progress.columns() if self.progress and self.progress.fits else {}


def progress_now(stage: str, done: int, total: int) -> JobProgress:
    return JobProgress(stage, done, total, now_ns())


def _is_text(said: str, longest: int) -> bool:
    return len(said) <= longest and "\x00" not in said and not any("\ud800" <= one <= "\udfff" for one in said)


AT_A_TIME = 500
LONGEST_PLAIN = 900
LONGEST_LEVEL = 8
OUTAGES = (OperationalError, InterfaceError, TimeoutError)
"""The database did not answer, or had no time: the same statement may pass the next time. What else it raises is of
what was to be written (a number that no column holds, a character that no text may have), and comes again."""


def write_lines(session: Session, words: Sequence[AttemptWords]) -> None:
    """Insert those lines that are not there yet, of several attempts at once."""
    rows = [_row(one, line) for one in words for line in one.lines]
    for first in range(0, len(rows), AT_A_TIME):
        insert_new(session, JobLine, rows[first : first + AT_A_TIME])


def write_lines_singly(session: Session, words: AttemptWords) -> None:
    """As `write_lines`, after the database refused one of them: that one's row says so instead of what it said."""
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
    """As `write_lines`, in a transaction that is about something else and that no line may make fail."""
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
    """Whether every database takes it for sure: short, of ASCII without control characters, numbers finite."""
    try:
        said = json.dumps([line.level, line.event, line.facts], allow_nan=False)
    except (TypeError, ValueError, RecursionError):
        return False
    return len(said) <= LONGEST_PLAIN and len(line.level) <= LONGEST_LEVEL and "\\" not in said


def _row(words: AttemptWords, line: AttemptLine) -> dict[str, Any]:
    return {"job_id": words.job_id, "attempt": words.attempt, **asdict(line)}


def _unkept(error: Exception) -> str:
    return f"this line cannot be stored: the database rejected it ({type(error).__name__})"
