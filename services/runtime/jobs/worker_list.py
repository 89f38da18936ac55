"""Running attempts by the database, and Celery nodes by the broker.

**Conventions.** The broker may be away; whoever asks is told so, within seconds.
"""

from collections.abc import Callable

from kombu.exceptions import OperationalError
from redis import RedisError
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.jobs.broker_app import make_app
from services.runtime.orm import Job, JobAttempt
from services.runtime.settings import Settings
from stone.errors import StoneError

PATIENCE_S = 1.0


class BrokerAwayError(StoneError):
    """The broker does not answer."""

    code = "broker_away"

    def __init__(self, reason: str) -> None:
        super().__init__(f"the broker does not answer ({reason[:200]}); is Redis running?")


def node_calls(settings: Settings) -> Callable[[], list[str]]:
    """The function that calls all nodes and tells who answered in a second. Raises `BrokerAwayError`."""
    app = make_app(settings)

    def answering_nodes() -> list[str]:
        try:
            with app.connection_for_write() as connection:
                connection.ensure_connection(max_retries=1, timeout=PATIENCE_S)
                answers = app.control.ping(timeout=PATIENCE_S, connection=connection)
        except (OperationalError, RedisError, OSError) as error:
            raise BrokerAwayError(str(error)) from error
        return sorted(name for answer in answers for name in answer)

    return answering_nodes


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
