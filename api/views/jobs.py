"""Jobs as the API shows them: rows of `services.runtime.orm.jobs` become bodies of `api.schemas.jobs`."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, cast

from sqlalchemy import Row, Select, bindparam, case, func, select, tuple_
from sqlalchemy.orm import Session

from api.errors import bad_cursor
from api.schemas.base import instant, instant_or_none
from api.schemas.jobs import AttemptItem, FailureItem, JobDetail, JobItem, LogLine, LogPage, StageItem
from services.domain.runs.estimates import time_left
from services.runtime.jobs.queries import Progress, StageProgress, progress_of, title_of
from services.runtime.jobs.specs import RETICENT, TERMINAL
from services.runtime.orm import Job, JobAttempt, JobLine, SubmissionRow
from services.runtime.orm.base import now_ns

SAID = (
    Job.id, Job.root_id, Job.owner_id, Job.sequence_id, Job.kind, Job.queue, Job.state, Job.priority, Job.attempt,
    Job.failure_code, Job.failure, Job.cancel_reason, Job.revision, Job.created_ns, Job.started_ns, Job.finished_ns,
)  # fmt: skip
"""The columns of a job that `job_facts` reads."""
_said_of = attrgetter(*(column.key for column in SAID))
OWN_PROGRESS = (Job.stage, Job.done, Job.total, Job.progress_ns)
# Built once, because building a statement for fifty ids costs more than running it.
DONE = func.sum(case((Job.state == "succeeded", 1), else_=0))
COUNTED = (
    select(Job.root_id, DONE, func.count())
    .where(Job.root_id.in_(bindparam("runs", expanding=True)), Job.queue != "")
    .group_by(Job.root_id)
)


def with_counts(page: Select[Job]) -> Select[Any]:
    """Select `SAID` and `OWN_PROGRESS` of the jobs of `page`, newest first, and for runs the done and total jobs."""
    shown = page.with_only_columns(*SAID, *OWN_PROGRESS).cte("shown")
    of_runs = (Job.root_id.in_(select(shown.c.id)), Job.queue != "")
    counted = select(Job.root_id, DONE.label("jobs_done"), func.count().label("jobs")).where(*of_runs)
    counts = counted.group_by(Job.root_id).subquery("counts")
    return (
        select(shown, func.coalesce(counts.c.jobs_done, 0), func.coalesce(counts.c.jobs, 0))
        .outerjoin(counts, counts.c.root_id == shown.c.id)
        .order_by(shown.c.id.desc())
    )


def facts_of_rows(session: Session, rows: Sequence[Row[Any]]) -> list[dict[str, Any]]:
    """Return rows of `with_counts` as a list shows them; live jobs are read for the estimates."""
    left = _time_left(session, cast("Sequence[Job]", rows))
    return [job_facts(row[: len(SAID)], _progress_of_row(session, row), left.get(row.id)) for row in rows]


def _time_left(session: Session, jobs: Sequence[Job]) -> Mapping[str, int]:
    """Return the estimated seconds left of live runs."""
    alive = [job.id for job in jobs if job.id == job.root_id and job.state not in TERMINAL]
    return time_left(session, alive) if alive else {}


def _progress_of_row(session: Session, row: Row[Any]) -> Progress:
    if row.queue:
        return progress_of(session, cast("Job", row))
    counts: Sequence[Any] = row[-2:]
    done, total = map(int, counts)
    return Progress("", done, total)


def job_items(session: Session, jobs: Sequence[Job]) -> list[JobItem]:
    """Return jobs as a list shows them; one statement reads the progress of all runs, and one their estimates."""
    runs = [job.id for job in jobs if not job.queue]
    counts = {root: (done, total) for root, done, total in session.execute(COUNTED, {"runs": runs})} if runs else {}
    left = _time_left(session, jobs)
    return [job_item(job, _glance(session, job, counts.get(job.id, (0, 0))), left.get(job.id)) for job in jobs]


def job_detail(session: Session, job: Job) -> JobDetail:
    """Return a job with its attempts, a run with its stages."""
    progress = progress_of(session, job)
    attempts = select(JobAttempt).where(JobAttempt.job_id == job.id).order_by(JobAttempt.number)
    return JobDetail(
        **dict(job_item(job, progress, _time_left(session, [job]).get(job.id))),
        stages=[_stage(stage) for stage in progress.stages],
        attempts=[_attempt(row) for row in session.scalars(attempts)],
        attempts_left=job.attempts_left if job.queue else 0,
        result=job.result,
    )


def _glance(session: Session, job: Job, counts: tuple[int, int]) -> Progress:
    if job.queue:
        return progress_of(session, job)
    return Progress("", *counts)


def job_item(job: Job, progress: Progress, left_s: int | None) -> JobItem:
    """Return the job; `left_s` is the estimate of `services/domain/runs/estimates.py`."""
    return JobItem(**job_facts(_said_of(job), progress, left_s))


def job_facts(said: Sequence[Any], progress: Progress, left_s: int | None) -> dict[str, Any]:
    """Return a `JobItem` from the values of `SAID`."""
    id, root_id, owner_id, sequence_id, kind, queue, state, priority, attempt, *more = said
    failure_code, failure, cancel_reason, revision, created_ns, started_ns, finished_ns = more
    return {
        "id": id,
        "root_id": root_id,
        "owner_id": owner_id,
        "sequence_id": sequence_id,
        "kind": kind,
        "title": title_of(kind),
        "queue": queue,
        "state": state,
        "priority": priority,
        "attempt": attempt,
        "progress": _progress(progress, left_s),
        "failure": _failure(failure_code, failure),
        "cancel_reason": cancel_reason,
        "revision": revision,
        "created_at": instant(created_ns),
        "started_at": instant_or_none(started_ns),
        "finished_at": instant_or_none(finished_ns),
    }


def _stage(stage: StageProgress) -> StageItem:
    return StageItem.of(stage, title=title_of(stage.kind), busy_s=stage.busy_ns / 1e9)


def _progress(progress: Progress, left_s: int | None) -> dict[str, Any]:
    counts = {"stage": progress.stage, "done": progress.done, "total": progress.total}
    return {**counts, "rate_per_s": progress.rate_per_s, "eta_s": left_s}


def _attempt(row: JobAttempt) -> AttemptItem:
    return AttemptItem.of(row, failure=_failure(row.failure_code, row.failure))


def coded_failure(row: Job | SubmissionRow) -> FailureItem | None:
    """Return why the row ended badly, None if it has no code of a failure."""
    return FailureItem(code=row.failure_code, sentence=row.failure) if row.failure_code else None


def _failure(code: str, sentence: str) -> dict[str, str] | None:
    return {"code": code, "sentence": sentence} if code or sentence else None


# Job logs by pages, also while the job runs.
#
# **Conventions.** `after` names the last line that was read: `<logged_ns>.<job id>.<attempt>.<number>`. The lines of
# one job come in the order of writing. Those of a run come in the order of their clocks. Workers write twice a second,
# so a line may arrive after a later one; while the run lasts, lines younger than `SETTLE_S` are held back.


SETTLE_S = 2.0
AFTER = re.compile(r"(\d{1,18}|[1-8]\d{18})\.([0-9a-f]{32})\.(\d{1,9})\.(\d{1,9})")


@dataclass(frozen=True)
class LogQuery:
    """The requested log lines."""

    after: str | None
    limit: int


def log_page(session: Session, job: Job, query: LogQuery, *, is_administrator: bool = False) -> LogPage:
    """Return the next lines of a job, or of all jobs of a run. Raises `bad_cursor`.

    Only administrators see tracebacks of jobs with access to hidden data.
    """
    mark = _mark(query.after)
    statement = _of_run(job, mark) if not job.queue else _of_job(job, mark)
    reticent = set() if is_administrator else set(session.scalars(_jobs_with_hidden_data(job)))
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


def _jobs_with_hidden_data(job: Job) -> Select[str]:
    """Select the jobs of the run that have read hidden data."""
    return select(Job.id).where(Job.root_id == job.root_id, Job.queue.in_(RETICENT))


def _mark(after: str | None) -> tuple[int, str, int, int] | None:
    if after is None:
        return None
    match = AFTER.fullmatch(after)
    if match is None:
        raise bad_cursor()
    logged_ns, job_id, attempt, number = match.groups()
    return int(logged_ns), job_id, int(attempt), int(number)


def _named(line: LogLine) -> str:
    return f"{line.logged_ns}.{line.job_id}.{line.attempt}.{line.number}"


def _line(row: JobLine, is_reticent: bool) -> LogLine:
    facts = {name: value for name, value in row.facts.items() if name != "traceback"} if is_reticent else row.facts
    return LogLine.of(row, facts=facts)
