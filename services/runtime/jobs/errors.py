"""Errors that stop a job, or refuse an action on one."""

from stone.errors import StoneError


class JobCancelledError(StoneError):
    """The job was cancelled; raised inside its attempt at the next progress report."""

    code = "cancelled"

    def __init__(self, reason: str) -> None:
        super().__init__(f"cancelled: {reason}")


class LostAttemptError(StoneError):
    """The attempt lost its lease: it was terminated, or requeued after missing heartbeats."""

    code = "attempt_lost"

    def __init__(self, job_id: str, attempt: int) -> None:
        super().__init__(f"attempt {attempt} of job {job_id} has lost its lease; its results are discarded")


class JobStateError(StoneError):
    """The job's state does not allow the action."""

    code = "wrong_state"

    def __init__(self, job_id: str, state: str, act: str, allowed: str) -> None:
        super().__init__(f"job {job_id} is {state} and cannot be {act}; only {allowed} jobs can")


class QueueDrainingError(StoneError):
    """The queue accepts no new jobs until it is resumed."""

    code = "queue_draining"

    def __init__(self, queue: str) -> None:
        super().__init__(f"queue {queue!r} is draining and accepts no new jobs; try again when it is open")
