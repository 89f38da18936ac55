"""Job logs by pages, also while the job runs.

**Conventions.** `after` names the last line that was read: `<logged_ns>.<job id>.<attempt>.<number>`. The lines of one
job come in the order they were said. Those of a run come in the order of their clocks, and what is younger than
`SETTLE_S` is held back while the run lasts: workers write twice a second, so a line may arrive after a later one.
"""

import re
from dataclasses import dataclass

from sqlalchemy import Select, select, tuple_
from sqlalchemy.orm import Session

from api.errors import BadCursorError
from api.schemas.base import instant
from api.schemas.jobs import LogLine, LogPage
from services.runtime.jobs.specs import RETICENT, TERMINAL
from services.runtime.orm import Job, JobLine
from services.runtime.orm.base import now_ns

SETTLE_S = 2.0
AFTER = re.compile(r"(\d{1,18}|[1-8]\d{18})\.([0-9a-f]{32})\.(\d{1,9})\.(\d{1,9})")


@dataclass(frozen=True)
class LogQuery:
    """Which lines are asked for."""

    after: str | None
    limit: int


def log_page(session: Session, job: Job, query: LogQuery, *, is_administrator: bool = False) -> LogPage:
    """The next lines of a job, or of all jobs of a run. Raises `BadCursorError`.

    Tracebacks of jobs that see what their owners may not are for administrators.
    """
    mark = _mark(query.after)
    statement = _of_run(job, mark) if not job.queue else _of_job(job, mark)
    reticent = set() if is_administrator else set(session.scalars(_reticent(job)))
    lines = [_line(row, row.job_id in reticent) for row in session.scalars(statement.limit(query.limit))]
    return LogPage(items=lines, next=_named(lines[-1]) if lines else query.after)


def _of_job(job: Job, mark: tuple[int, str, int, int] | None) -> Select[JobLine]:
    statement = select(JobLine).where(JobLine.job_id == job.id).order_by(JobLine.attempt, JobLine.number)
    return statement if mark is None else statement.where(tuple_(JobLine.attempt, JobLine.number) > tuple_(*mark[2:]))


def _of_run(job: Job, mark: tuple[int, str, int, int] | None) -> Select[JobLine]:
    order = (JobLine.logged_ns, JobLine.job_id, JobLine.attempt, JobLine.number)
    statement = select(JobLine).join(Job, Job.id == JobLine.job_id).where(Job.root_id == job.id).order_by(*order)
    if job.state not in TERMINAL:
        statement = statement.where(JobLine.logged_ns < now_ns() - int(SETTLE_S * 1e9))
    return statement if mark is None else statement.where(tuple_(*order) > tuple_(*mark))


def _reticent(job: Job) -> Select[str]:
    """The jobs of the run that have seen what is hidden."""
    return select(Job.id).where(Job.root_id == job.root_id, Job.queue.in_(RETICENT))


def _mark(after: str | None) -> tuple[int, str, int, int] | None:
    if after is None:
        return None
    found = AFTER.fullmatch(after)
    if found is None:
        raise BadCursorError()
    logged_ns, job_id, attempt, number = found.groups()
    return int(logged_ns), job_id, int(attempt), int(number)


def _named(line: LogLine) -> str:
    return f"{line.logged_ns}.{line.job_id}.{line.attempt}.{line.number}"


def _line(row: JobLine, is_reticent: bool) -> LogLine:
    facts = {name: value for name, value in row.facts.items() if name != "traceback"} if is_reticent else row.facts
    return LogLine(
        job_id=row.job_id,
        attempt=row.attempt,
        number=row.number,
        logged_ns=row.logged_ns,
        logged_at=instant(row.logged_ns),
        level=row.level,
        event=row.event,
        facts=facts,
    )
