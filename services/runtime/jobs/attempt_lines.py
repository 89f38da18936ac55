"""Log lines of an attempt as rows: written once however often they are sent.

**Conventions.** A line has its number from the moment it is said, and (job, attempt, number) is its key: after a commit
whose answer was lost the same lines are sent again, and those that are there stay as they are.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from sqlalchemy.exc import InterfaceError, OperationalError, TimeoutError
from sqlalchemy.orm import Session

from services.runtime.database.inserts import insert_new
from services.runtime.jobs.claims import Claim
from services.runtime.orm import JobLine

AT_A_TIME = 500
OUTAGES = (OperationalError, InterfaceError, TimeoutError)
"""The database did not answer, or had no time: the same statement may pass the next time. What else it raises is of
what was to be written (a number that no column holds, a character that no text may have), and comes again."""


@dataclass(frozen=True)
class AttemptLine:
    """One line; `number` counts from 0 within its attempt."""

    number: int
    level: str
    event: str
    facts: dict[str, Any]
    logged_ns: int


def write_lines(session: Session, claim: Claim, lines: Sequence[AttemptLine]) -> None:
    """Insert those that are not there yet."""
    for first in range(0, len(lines), AT_A_TIME):
        insert_new(session, JobLine, [_row(claim, line) for line in lines[first : first + AT_A_TIME]])


def write_lines_singly(session: Session, claim: Claim, lines: Sequence[AttemptLine]) -> None:
    """As `write_lines`, after the database refused one of them: that one's row says so instead of what it said."""
    for line in lines:
        try:
            with session.begin_nested():
                insert_new(session, JobLine, [_row(claim, line)])
        except OUTAGES:
            raise
        except Exception as error:
            kept = AttemptLine(line.number, "warning", _unkept(error), {}, line.logged_ns)
            insert_new(session, JobLine, [_row(claim, kept)])


def _row(claim: Claim, line: AttemptLine) -> dict[str, Any]:
    return {"job_id": claim.job_id, "attempt": claim.attempt, **asdict(line)}


def _unkept(error: Exception) -> str:
    return f"this line cannot be kept: the database does not take it ({type(error).__name__})"
