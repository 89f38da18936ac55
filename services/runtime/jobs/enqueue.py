"""Enqueues jobs: rows in the caller's transaction, wake-ups after its commit."""

from collections.abc import Sequence

from sqlalchemy import insert, select
from sqlalchemy.orm import Session

from services.runtime.database.transactions import wake_up_after_commit
from services.runtime.jobs.errors import QueueDrainingError
from services.runtime.jobs.specs import Context, JobSpec
from services.runtime.orm import Job, JobNeed, Queue, new_id
from services.runtime.orm.base import now_ns


def enqueue(session: Session, spec: JobSpec, context: Context, max_attempts: int = 3) -> Job:
    """One job that is its own run. Raises `QueueDrainingError`."""
    refuse_draining(session, [spec])
    job = _job(spec, context, max_attempts)
    job.root_id = job.id
    session.add(job)
    session.flush()
    wake_up_after_commit(session, job.queue)
    return job


def enqueue_run(session: Session, kind: str, specs: Sequence[JobSpec], context: Context, max_attempts: int = 3) -> Job:
    """A run of several jobs: it succeeds when all of them have, fails with the first. Raises `QueueDrainingError`."""
    if not specs:
        raise ValueError(f"run {kind!r} of no jobs would never end")
    refuse_draining(session, specs)
    run = Job(id=new_id(), kind=kind, owner_id=context.owner_id, sequence_id=context.sequence_id)
    run.root_id, run.priority, run.state = run.id, context.priority, "queued"
    session.add(run)
    session.flush()
    add_jobs(session, run, specs, max_attempts)
    return run


def add_jobs(session: Session, run: Job, specs: Sequence[JobSpec], max_attempts: int) -> list[Job]:
    """More jobs for a run, in the order in which they are to be taken; `needs` refer to keys within `specs`."""
    context = Context(run.owner_id, run.sequence_id, run.priority)
    jobs = [_job(spec, context, max_attempts, run.id) for spec in specs]
    for job, job_id in zip(jobs, sorted(job.id for job in jobs), strict=True):
        job.id = job_id  # made in one millisecond they would sort by chance
    id_of = {spec.key: job.id for spec, job in zip(specs, jobs, strict=True) if spec.key}
    session.add_all(jobs)
    session.flush()
    pairs = list(zip(specs, jobs, strict=True))
    needs = [{"job_id": job.id, "needed_id": id_of[key]} for spec, job in pairs for key in spec.needs]
    if needs:
        session.execute(insert(JobNeed).returning(JobNeed.job_id), needs)  # many rows a statement
    for spec, job in pairs:
        if not spec.needs:
            wake_up_after_commit(session, job.queue)
    return jobs


def refuse_draining(session: Session, specs: Sequence[JobSpec]) -> None:
    """Raises `QueueDrainingError` when any of these would go to a queue that takes nothing new."""
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
        needs_left=len(spec.needs),
        ready_ns=None if spec.needs else now_ns(),
        attempts_left=max_attempts,
    )
