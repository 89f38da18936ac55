"""Ends jobs: succeeded (dependents become ready), failed or cancelled; and settles their run.

**Conventions.** Each function needs one transaction and returns whether this attempt still held the job; otherwise it
changes nothing. The run's row is locked first, so two last jobs cannot both leave the run open. `words` is the last
report of the attempt, if its own process ends it; it is written with the end.
"""

from dataclasses import dataclass
from typing import Any

from sqlalchemy import Update, bindparam, select, update
from sqlalchemy.orm import Session

from services.runtime.database.transactions import wake_up_after_commit
from services.runtime.jobs.attempt_lines import AttemptWords, write_lines_beside
from services.runtime.jobs.changes import lock_run, revise_run, rows_changed
from services.runtime.jobs.claims import ONE, QUEUED, RUNNING, Claim
from services.runtime.jobs.enqueue import add_jobs
from services.runtime.jobs.specs import TERMINAL, Outcome
from services.runtime.notifications.events import tell_run_failed, tell_run_succeeded
from services.runtime.orm import Job, JobAttempt, JobNeed
from services.runtime.orm.base import now_ns
from services.runtime.store.own_names import without_paths
from services.runtime.telemetry.process_usage import peak_bytes, used_cpu_s

LONGEST_FAILURE = 2000
ONE_LEFT = (
    select(Job.id)
    .where(Job.root_id == bindparam("root"), Job.id != bindparam("root"), Job.state.in_((QUEUED, RUNNING)))
    .limit(ONE)
)
"""A job of the run `root` that has not ended."""


@dataclass(frozen=True)
class Failure:
    """The failure of an attempt or a job: a code for programs, and a sentence for people without the server's paths."""

    code: str
    sentence: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "sentence", without_paths(self.sentence))

    def columns(self) -> dict[str, str]:
        return {"failure_code": self.code, "failure": self.sentence[:LONGEST_FAILURE]}


def succeed(
    session: Session, claim: Claim, outcome: Outcome, max_attempts: int, words: AttemptWords | None = None
) -> bool:
    """Record the success, its rows and the following jobs; wake-ups are sent for ready dependents.

    If the run was cancelled, the following jobs are created as cancelled, so that a retry runs them.
    """
    is_run = claim.job_id == claim.root_id
    run = (lock_run if is_run else revise_run)(session, claim.root_id)
    changes = _changes_of(words)
    if not _leave(
        session,
        claim,
        "succeeded",
        **{**changes, "result": dict(outcome.result), "done": changes.get("total", Job.total)},
    ):
        return False
    _note(session, claim, "succeeded", None, words)
    outcome.commit(session)
    if is_run:
        if outcome.then:
            raise ValueError(f"{claim.kind} is a whole run and cannot be followed by other jobs")
        tell_run_succeeded(session, run)
        return True
    if run.state not in TERMINAL:
        goes_on = _release(session, claim.job_id)  # first: jobs added after this kind count it as done
        goes_on = bool(add_jobs(session, run, outcome.then, max_attempts)) or goes_on
        if run.cancel_reason:
            cancel_queued(session, run)
        if run.cancel_reason or not goes_on:
            _end_run(session, run)
    return True


def fail(session: Session, claim: Claim, failure: Failure, words: AttemptWords | None = None) -> bool:
    """Record the failure; its run fails too, and the run's queued jobs are cancelled."""
    run = lock_run(session, claim.root_id)
    if not _leave(session, claim, "failed", **_changes_of(words), **failure.columns()):
        return False
    _note(session, claim, "failed", failure, words)
    fail_run(session, run, claim.job_id, failure)
    return True


def cancelled(session: Session, claim: Claim, words: AttemptWords | None = None) -> bool:
    """Record that the attempt stopped because of a cancellation."""
    run = lock_run(session, claim.root_id)
    if not _leave(session, claim, "cancelled", **_changes_of(words)):
        return False
    _note(session, claim, "cancelled", None, words)
    _finish_run(session, run)
    return True


def lose(session: Session, claim: Claim, failure: Failure, words: AttemptWords | None = None) -> bool:
    """Queue the job again after an attempt that failed for no fault of the input, or fail it without tries left.

    A cancelled job is not tried again: it ends cancelled.
    """
    run = lock_run(session, claim.root_id)
    if run.cancel_reason:
        return cancelled(session, claim, words)
    held, again = _held(claim).where(Job.attempts_left > 0), {"state": "queued", "ready_ns": now_ns()}
    if not rows_changed(session, held.values(**again, **_changes_of(words), revision=Job.revision + 1)):
        return fail(session, claim, failure, words)
    _note(session, claim, "lost", failure, words)
    wake_up_after_commit(session, claim.kind.partition(".")[0])
    return True


def fail_run(session: Session, run: Job, job_id: str, failure: Failure) -> None:
    """Fail the run of a failed job: no job starts, running jobs are cancelled, and the reason is stored."""
    if run.id == job_id:
        tell_run_failed(session, run, failure.code, failure.sentence)
        return
    if not run.failure_code:
        run.failure_code, run.failure = failure.code, failure.sentence[:LONGEST_FAILURE]
        run.cancel_reason = run.cancel_reason or f"job {job_id} failed: {failure.code}"
    cancel_queued(session, run)
    _finish_run(session, run)


def cancel_queued(session: Session, run: Job) -> None:
    """Cancel the unstarted jobs of the run."""
    queued = update(Job).where(Job.root_id == run.id, Job.id != run.id, Job.state == "queued")
    session.execute(queued.values(state="cancelled", finished_ns=now_ns(), revision=Job.revision + 1))


def settle(session: Session, run: Job) -> None:
    """End the run if all its jobs have ended."""
    _finish_run(session, run)


def _finish_run(session: Session, run: Job) -> None:
    if run.queue:  # a job that is its own run has ended itself
        return
    run.revision += 1
    if run.state not in TERMINAL:
        _end_run(session, run)


def _end_run(session: Session, run: Job) -> None:
    """End an unfinished run if none of its jobs waits or runs."""
    session.flush()
    if session.execute(ONE_LEFT, {"root": run.id}).first():
        return
    if run.failure_code:
        run.state = "failed"
        tell_run_failed(session, run, run.failure_code, run.failure)
    else:
        run.state = "cancelled" if run.cancel_reason else "succeeded"
        if run.state == "succeeded":
            tell_run_succeeded(session, run)
    run.finished_ns = now_ns()


def _release(session: Session, job_id: str) -> bool:
    """Count this success in every job that needs it, and send wake-ups for jobs that become ready.

    Returns whether any dependent job is unfinished.
    """
    waiting = select(JobNeed.job_id).where(JobNeed.needed_id == job_id)
    counted_off = update(Job).where(Job.id.in_(waiting)).values(needs_left=Job.needs_left - 1, ready_ns=now_ns())
    left = session.execute(
        counted_off.returning(Job.queue, Job.needs_left, Job.state), execution_options={"synchronize_session": False}
    )
    to_run = [(queue, needs_left) for queue, needs_left, state in left if state == "queued"]
    for queue, needs_left in to_run:
        if needs_left == 0:
            wake_up_after_commit(session, queue)
    return bool(to_run)


def _held(claim: Claim) -> Update:
    return update(Job).where(Job.id == claim.job_id, Job.state == "running", Job.attempt == claim.attempt)


def _leave(session: Session, claim: Claim, state: str, **columns: object) -> bool:
    values = {"state": state, "finished_ns": now_ns(), "revision": Job.revision + 1, **columns}
    return rows_changed(session, _held(claim).values(**values)) == 1


def _changes_of(words: AttemptWords | None) -> dict[str, Any]:
    """Return the changes of the last report in the job's row."""
    return words.columns() if words else {}


def _note(session: Session, claim: Claim, outcome: str, failure: Failure | None, words: AttemptWords | None) -> None:
    """Close the attempt's row; resource usage with children is stored if its own process reports it."""
    attempt = update(JobAttempt).where(JobAttempt.job_id == claim.job_id, JobAttempt.number == claim.attempt)
    columns: dict[str, Any] = dict(failure.columns()) if failure else {}
    if claim.begun_cpu_s is not None:
        columns |= {"cpu_s": used_cpu_s() - claim.begun_cpu_s, "peak_bytes": peak_bytes()}
    session.execute(attempt.values(outcome=outcome, finished_ns=now_ns(), **columns))
    if words:
        write_lines_beside(session, words)
