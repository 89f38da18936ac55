"""The administrator's view over the wire: jobs with their children, queues, workers."""

from typing import Annotated

from pydantic import Field

from api.schemas.base import ID_EXAMPLE, PLAIN, Answer, Body, Reason, example
from api.schemas.jobs import ATTEMPT_EXAMPLE, JOB_EXAMPLE, STAGES_EXAMPLE, JobDetail, JobItem


class ReasonBody(Body):
    """Why an administrator does this; it is kept in the audit log."""

    model_config = example(reason="worker-3 is being replaced")

    reason: Reason


class CancelBody(Body):
    """Why the job is stopped, in its owner's words."""

    model_config = example(reason="wrong calibration")

    reason: Annotated[str, Field(pattern=PLAIN, max_length=500)] = ""


class AdminJobDetail(JobDetail):
    """A job with its attempts, and of a run the jobs that are unfinished or failed, newest first."""

    model_config = example(
        **JOB_EXAMPLE,
        stages=STAGES_EXAMPLE,
        attempts=[ATTEMPT_EXAMPLE],
        attempts_left=2,
        result=None,
        children=[],
        children_total=52,
    )

    children: list[JobItem]
    children_total: int


class QueueItem(Answer):
    """A queue: `mode` is open, paused or draining; jobs ready, waiting for others, and running.

    `bells` are messages that no worker has heard yet; null where the broker does not answer.
    """

    model_config = example(name="labeler", mode="open", ready=3, waiting=28, running=2, bells=3)

    name: str
    mode: str
    ready: int
    waiting: int
    running: int
    bells: int | None


class RunningAttempt(Answer):
    """What a worker process is busy with."""

    model_config = example(job_id=ID_EXAMPLE, kind="labeler.surface", attempt=1, worker="worker-3:4711")

    job_id: str
    kind: str
    attempt: int
    worker: str


class WorkersAnswer(Answer):
    """Attempts that run, as the database has them, and the Celery nodes that answered a ping.

    `is_broker_reachable` false means that nodes could not be asked: an empty list then says nothing.
    """

    model_config = example(
        running=[{"job_id": ID_EXAMPLE, "kind": "labeler.surface", "attempt": 1, "worker": "worker-3:4711"}],
        nodes=["celery@worker-3"],
        is_broker_reachable=True,
    )

    running: list[RunningAttempt]
    nodes: list[str]
    is_broker_reachable: bool
