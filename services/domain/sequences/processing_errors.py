"""Errors of starting to process a sequence."""

from stone.errors import StoneError


class SequenceDeletedError(StoneError):
    """The sequence was deleted and cannot be processed."""

    code = "sequence_deleted"

    def __init__(self, sequence_id: str) -> None:
        super().__init__(f"sequence {sequence_id} was deleted and cannot be processed")


class RecordingPendingError(StoneError):
    """A recording is still being read."""

    code = "recording_pending"

    def __init__(self, sequence_id: str, pending: int) -> None:
        super().__init__(f"{pending} recordings of sequence {sequence_id} are still being read; wait for their jobs")


class AlreadyProcessingError(StoneError):
    """Another run is in progress; `job_id` is its id."""

    code = "already_processing"

    def __init__(self, sequence_id: str, job_id: str) -> None:
        self.job_id = job_id
        super().__init__(
            f"job {job_id} is processing sequence {sequence_id} with other inputs; wait for the job, or cancel it first"
        )
