"""Renews the leases of running attempts: heartbeats, progress and log lines of all of them in one transaction.

**Conventions.** A row that another transaction has locked (to end or to requeue the job) is skipped, so that one job
never delays the heartbeats of the others. Its attempt sends the same report in the next turn. Rejected reports do not
prevent heartbeats: these are written first, then each attempt's lines separately.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import bindparam, case, select, tuple_, update
from sqlalchemy.orm import Session, aliased

from services.runtime.database.transactions import Database
from services.runtime.jobs.attempt_lines import OUTAGES, AttemptKey, AttemptWords, write_lines, write_lines_singly
from services.runtime.jobs.specs import nothing
from services.runtime.orm import Job

# Built once, because building one of these takes longer than running it. `keys` are (job, attempt).
KEY = tuple_(Job.id, Job.attempt)
AMONG = KEY.in_(bindparam("keys", expanding=True))
RUN = aliased(Job)
HELD = select(Job.id).where(AMONG, Job.state == "running").with_for_update(skip_locked=True, key_share=True)
BEATEN = update(Job).where(Job.id.in_(HELD)).returning(Job.id, Job.attempt)
REASONS = (
    select(Job.id, Job.attempt, Job.cancel_reason, RUN.cancel_reason)
    .join(RUN, RUN.id == Job.root_id)
    .where(AMONG, Job.state == "running")
)


@dataclass(frozen=True)
class LeaseAnswer:
    """Whether the attempt still holds its job, the reason to stop if it must, and whether its report is written."""

    is_held: bool
    cancel_reason: str = ""
    is_written: bool = True


def renew(
    database: Database, words: Sequence[AttemptWords], beside: Callable[[Session], None] = nothing
) -> list[LeaseAnswer]:
    """Return the answer to each report, in order; `beside` writes other rows in the same transaction.

    If a report is rejected, `beside` is not called. Raises what the database raises if no heartbeat could be written.
    """
    try:
        with database.transaction() as session:
            answers = _beat(session, words) if words else []
            write_lines(session, words)
            beside(session)
    except OUTAGES:
        raise
    except Exception:
        return _renew_apart(database, words)
    return answers


def _renew_apart(database: Database, words: Sequence[AttemptWords]) -> list[LeaseAnswer]:
    with database.transaction() as session:
        answers = _beat(session, words)
    for report in words:
        if report.lines:
            with database.transaction() as session:
                write_lines_singly(session, report)
    return answers


def _beat(session: Session, words: Sequence[AttemptWords]) -> list[LeaseAnswer]:
    beaten = BEATEN.values(heartbeats=Job.heartbeats + 1, **_progress(words))
    rows = session.execute(beaten, _keys(words), execution_options={"synchronize_session": False})
    written = {(job_id, attempt) for job_id, attempt in rows}
    reasons = _reasons(session, words)
    return [
        LeaseAnswer(report.key in written or report.key in reasons, reasons.get(report.key, ""), report.key in written)
        for report in words
    ]


def _reasons(session: Session, words: Sequence[AttemptWords]) -> dict[AttemptKey, str]:
    """Return the reason to stop ("" for none) of each running attempt; locked rows count as running."""
    rows = session.execute(REASONS, _keys(words))
    return {(job_id, attempt): own or of_run for job_id, attempt, own, of_run in rows}


def _keys(words: Sequence[AttemptWords]) -> dict[str, list[AttemptKey]]:
    return {"keys": [report.key for report in words]}


def _progress(words: Sequence[AttemptWords]) -> Mapping[str, Any]:
    """Return the new value of each column of progress, for attempts with a report."""
    changes = [(KEY.in_([report.key]), columns) for report in words if (columns := report.columns())]
    if not changes:
        return {}
    columns = {
        name: case(*((is_its, of[name]) for is_its, of in changes), else_=getattr(Job, name)) for name in changes[0][1]
    }
    return {**columns, "revision": case(*((is_its, Job.revision + 1) for is_its, _ in changes), else_=Job.revision)}
