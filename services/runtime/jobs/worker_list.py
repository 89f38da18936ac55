"""Running attempts, by the database."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.orm import Job, JobAttempt


def running_attempts(session: Session, limit: int) -> list[tuple[Job, JobAttempt]]:
    """Jobs that a worker holds, the oldest attempt first."""
    running = (
        select(Job, JobAttempt)
        .join(JobAttempt, (JobAttempt.job_id == Job.id) & (JobAttempt.number == Job.attempt))
        .where(Job.state == "running", Job.queue != "")
        .order_by(JobAttempt.started_ns, Job.id)
        .limit(limit)
    )
    return [(job, attempt) for job, attempt in session.execute(running)]
