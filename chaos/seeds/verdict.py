"""The rules for jobs at any step of a history and at its end; each violation is a sentence.

**Conventions.** The rules compare the rows with the world's record of requests. At any step:

- no success is lost or counted twice, and the jobs that follow a success exist;
- a job starts after the jobs that it needs;
- a run has ended if and only if its jobs have;
- each attempt is open as long as its job runs.

At the end every run has ended, and a stopped run has ended as stopped.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from sqlalchemy import Row, text
from sqlalchemy.orm import Session

from chaos.seeds.actors import REFUSED, STUMBLED
from chaos.seeds.faulty_database import OutageError
from chaos.seeds.world import World
from services.runtime.jobs.lease_sweep import STOPPED, WORKER_STOPPED
from services.runtime.jobs.specs import TERMINAL

JOBS = text(
    "SELECT id, root_id, queue, state, attempt, attempts_left, needs_left, cancel_reason, failure_code, failure,"
    " json_extract(result, '$.then') AS brings, json_extract(arguments, '$.by') AS by, finished_ns FROM jobs"
)
ATTEMPTS = text("SELECT job_id, number, outcome, failure_code, finished_ns FROM job_attempts ORDER BY job_id, number")
NEEDS = text("SELECT job_id, needed_id FROM job_needs")
EFFECTS = text("SELECT name, value FROM figures")
UNCOUNTED = (STOPPED.code, WORKER_STOPPED.code)
CODES = (REFUSED, "internal_error", "worker_lost", "time_limit", *UNCOUNTED)
OUTAGE = f"{OutageError.__name__}: "


@dataclass(frozen=True)
class Rows:
    """All rows of a history."""

    jobs: dict[str, Row[tuple[object, ...]]]
    attempts: Sequence[Row[tuple[object, ...]]]
    needs: Sequence[Row[tuple[object, ...]]]
    effects: dict[str, int]

    @classmethod
    def of(cls, session: Session) -> "Rows":
        effects = {name: value for name, value in session.execute(EFFECTS)}
        jobs = {row.id: row for row in session.execute(JOBS)}
        return cls(jobs, session.execute(ATTEMPTS).all(), session.execute(NEEDS).all(), effects)


def judge_step(rows: Rows) -> Iterator[str]:
    """Yield the violations of the rules that hold between any two transactions."""
    yield from _judge_effects(rows)
    yield from _judge_needs(rows)
    yield from _judge_runs(rows)
    running = sorted(row.id for row in rows.jobs.values() if row.queue and row.state == "running")
    if sorted(row.job_id for row in rows.attempts if not row.outcome) != running:
        yield f"the open attempts do not match the running jobs {running}"


def judge_end(world: World, rows: Rows, most: int) -> Iterator[str]:
    """Yield the violations of the rules that hold after calm, when all actors rest."""
    yield from judge_step(rows)
    for row in rows.jobs.values():
        if row.state not in TERMINAL:
            yield f"lost: job {row.id} of run {row.root_id} stays {row.state}"
        if row.state == "failed":
            yield from _judge_failure(row)
        if row.id == row.root_id:
            yield from _judge_stop(world, row)
    yield from _judge_attempts(world, rows, most)


def _judge_effects(rows: Rows) -> Iterator[str]:
    followers = Counter(row.by for row in rows.jobs.values() if row.by)
    for row in rows.jobs.values():
        if not row.queue:
            continue
        effects, is_done = rows.effects.get(row.id, 0), row.state == "succeeded"
        if effects != is_done:
            yield f"{'doubled' if effects > is_done else 'lost'}: job {row.id} is {row.state}, with {effects} effects"
        if is_done and followers[row.id] != row.brings:
            yield f"lost: job {row.id} adds {row.brings} jobs, but {followers[row.id]} exist"


def _judge_needs(rows: Rows) -> Iterator[str]:
    left: Counter[str] = Counter()
    for need in rows.needs:
        left[need.job_id] += rows.jobs[need.needed_id].state != "succeeded"
    for row in rows.jobs.values():
        if row.state == "queued" and row.needs_left != left[row.id]:
            yield f"lost: job {row.id} waits for {row.needs_left} jobs, but {left[row.id]} are left"
        if row.state in ("running", "succeeded") and left[row.id]:
            yield f"job {row.id} began before {left[row.id]} of the jobs that it needs"


def _judge_runs(rows: Rows) -> Iterator[str]:
    states: dict[str, set[str]] = {}
    for row in rows.jobs.values():
        if row.id != row.root_id:
            states.setdefault(row.root_id, set()).add(row.state)
    for run_id, of_jobs in states.items():
        run = rows.jobs[run_id]
        if (run.state in TERMINAL) == bool(of_jobs & {"queued", "running"}):
            yield f"lost: run {run_id} is {run.state}, its jobs are {sorted(of_jobs)}"
        if run.state == "succeeded" and of_jobs != {"succeeded"}:
            yield f"run {run_id} succeeded, its jobs are {sorted(of_jobs)}"
        if run.cancel_reason and "queued" in of_jobs:
            yield f"run {run_id} was stopped, but has queued jobs"


def _judge_failure(row: Row[tuple[object, ...]]) -> Iterator[str]:
    """Yield a violation if the job's failure is not drawn: refused, stumbled, or out of attempts after faults."""
    if row.failure_code not in CODES:
        yield f"{row.id} failed with the unexpected code {row.failure_code!r}"
    if row.failure_code == "internal_error" and not (STUMBLED in row.failure or OUTAGE in row.failure):
        yield f"{row.id} failed by the platform's own fault: {row.failure}"


def _judge_stop(world: World, run: Row[tuple[object, ...]]) -> Iterator[str]:
    """Yield a violation if a stopped run did not end as stopped; a run that is one job may have finished first."""
    if not world.requests_of(run.id).stopped or run.state == "cancelled":
        return
    if run.state != "failed" and not run.queue:
        yield f"run {run.id} was stopped, but is {run.state}"


def _judge_attempts(world: World, rows: Rows, most: int) -> Iterator[str]:
    numbers: dict[str, list[int]] = {}
    counted: Counter[str] = Counter()
    succeeded: Counter[str] = Counter()
    for row in rows.attempts:
        numbers.setdefault(row.job_id, []).append(row.number)
        counted[row.job_id] += row.failure_code not in UNCOUNTED
        succeeded[row.job_id] += row.outcome == "succeeded"
    for job_id, kept in numbers.items():
        job = rows.jobs[job_id]
        if kept != list(range(1, job.attempt + 1)):
            yield f"lost: job {job_id} has had {job.attempt} attempts and keeps {kept}"
        if succeeded[job_id] != (job.state == "succeeded"):
            yield f"doubled: job {job_id} is {job.state} after {succeeded[job_id]} attempts that succeeded"
        allowed = most * (1 + world.requests_of(job.root_id).retries)
        if counted[job_id] > allowed:
            yield f"doubled: job {job_id} was tried {counted[job_id]} times, {allowed} are allowed"
