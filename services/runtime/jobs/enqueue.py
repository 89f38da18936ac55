"""Enqueues jobs: rows in the caller's transaction, wake-ups after its commit."""

from collections.abc import Mapping, Sequence

from sqlalchemy import insert, select
from sqlalchemy.orm import Session

from services.runtime.database.transactions import wake_up_after_commit
from services.runtime.jobs.errors import QueueDrainingError
from services.runtime.jobs.specs import Context, JobSpec
from services.runtime.orm import Job, JobNeed, Queue, new_id
from services.runtime.orm.base import now_ns


def enqueue(session: Session, spec: JobSpec, context: Context, max_attempts: int = 3) -> Job:
    """Enqueue one job that is its own run. Raises `QueueDrainingError`."""
    refuse_draining(session, [spec])
    job = _job(spec, context, max_attempts)
    job.root_id = job.id
    session.add(job)
    session.flush()
    wake_up_after_commit(session, job.queue)
    return job


def enqueue_run(session: Session, kind: str, specs: Sequence[JobSpec], context: Context, max_attempts: int = 3) -> Job:
    """Enqueue a run of several jobs, which succeeds with all and fails with the first. Raises `QueueDrainingError`."""
    if not specs:
        raise ValueError(f"run {kind!r} without jobs would never end")
    refuse_draining(session, specs)
    run = Job(id=new_id(), kind=kind, owner_id=context.owner_id, sequence_id=context.sequence_id)
    run.root_id, run.priority, run.state = run.id, context.priority, "queued"
    session.add(run)
    session.flush()
    add_jobs(session, run, specs, max_attempts)
    return run


def add_jobs(session: Session, run: Job, specs: Sequence[JobSpec], max_attempts: int) -> list[Job]:
    """Add jobs to a run, in the order in which they are taken; `needs` refer to keys within `specs`.

    For a started run, the caller holds the row's lock, so that a job named in `after` does not end meanwhile.
    """
    before = _jobs_before(session, run.id, specs)
    context = Context(run.owner_id, run.sequence_id, run.priority)
    jobs = [_job(spec, context, max_attempts, run.id) for spec in specs]
    for job, job_id in zip(jobs, sorted(job.id for job in jobs), strict=True):
        job.id = job_id  # ids of the same millisecond would sort randomly
    id_of = {spec.key: job.id for spec, job in zip(specs, jobs, strict=True) if spec.key}
    needed = {job.id: _needed_ids(spec, id_of, before) for spec, job in zip(specs, jobs, strict=True)}
    for job in jobs:
        job.needs_left = sum(needed[job.id].values())
        job.ready_ns = None if job.needs_left else now_ns()
    session.add_all(jobs)
    session.flush()
    rows = [{"job_id": job_id, "needed_id": needed_id} for job_id, ids in needed.items() for needed_id in ids]
    if rows:
        session.execute(insert(JobNeed).returning(JobNeed.job_id), rows)  # many rows per statement
    for job in jobs:
        if not job.needs_left:
            wake_up_after_commit(session, job.queue)
    return jobs


def _jobs_before(session: Session, root_id: str, specs: Sequence[JobSpec]) -> dict[str, dict[str, bool]]:
    """Return the run's jobs of each kind named in `after`, and whether they still have to succeed.

    Raises `ValueError` for a kind without jobs in the run.
    """
    kinds = {kind for spec in specs for kind in spec.after}
    if not kinds:
        return {}
    by_kind: dict[str, dict[str, bool]] = {kind: {} for kind in kinds}
    jobs = select(Job.id, Job.kind, Job.state).where(Job.root_id == root_id, Job.kind.in_(kinds))
    for job_id, kind, state in session.execute(jobs):
        by_kind[kind][job_id] = state != "succeeded"
    for kind in (kind for kind in sorted(kinds) if not by_kind[kind]):
        raise ValueError(f"run {root_id} has no job {kind!r} to wait for")
    return by_kind


def _needed_ids(spec: JobSpec, id_of: Mapping[str, str], before: Mapping[str, Mapping[str, bool]]) -> dict[str, bool]:
    """Return the needed jobs, and whether each still has to succeed."""
    of_batch = {id_of[key]: True for key in spec.needs}
    return of_batch | {job_id: waits for kind in spec.after for job_id, waits in before[kind].items()}


def refuse_draining(session: Session, specs: Sequence[JobSpec]) -> None:
    """Raise `QueueDrainingError` if a job's queue accepts no new jobs."""
    queues = {spec.queue for spec in specs}
    draining = select(Queue.name).where(Queue.name.in_(queues), Queue.mode == "draining")
    for name in session.scalars(draining):
        raise QueueDrainingError(name)


def _job(spec: JobSpec, context: Context, max_attempts: int, root_id: str = "") -> Job:
    return Job(
        id=new_id(),
        root_id=root_id,
        owner_id=context.owner_id,
        sequence_id=context.sequence_id,
        kind=spec.kind,
        queue=spec.queue,
        state="queued",
        priority=context.priority,
        arguments=dict(spec.arguments),
        ready_ns=now_ns(),
        attempts_left=max_attempts,
    )
