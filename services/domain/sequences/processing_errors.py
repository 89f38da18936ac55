"""Errors of starting to process a sequence."""

from stone.errors import StoneError


class SequenceDeletedError(StoneError):
    """The sequence was deleted; nothing more is made of it."""

    code = "sequence_deleted"

    def __init__(self, sequence_id: str) -> None:
        super().__init__(f"sequence {sequence_id} was deleted and cannot be processed")


class NoCalibrationError(StoneError):
    """No calibration is assigned."""

    code = "no_calibration"

    def __init__(self, sequence_id: str) -> None:
        super().__init__(f"sequence {sequence_id} has no calibration; assign one first")


class NoRecordingError(StoneError):
    """There is nothing to process, or what there is was refused."""

    code = "no_recording"

    def __init__(self, sequence_id: str, unusable: int) -> None:
        why = f"{unusable} could not be registered, see their findings" if unusable else "none was added"
        super().__init__(f"sequence {sequence_id} has no registered recording ({why}); add one first")


class RecordingPendingError(StoneError):
    """A recording is still being read."""

    code = "recording_pending"

    def __init__(self, sequence_id: str, pending: int) -> None:
        super().__init__(f"{pending} recordings of sequence {sequence_id} are still being read; wait for their jobs")


class UnknownRecordingError(StoneError):
    """A recording was asked for that the sequence has not, or that could not be registered."""

    code = "unknown_recording"

    def __init__(self, sequence_id: str, recording_id: str) -> None:
        super().__init__(
            f"{recording_id[:80]} is no registered recording of sequence {sequence_id}; was it removed, or refused?"
        )


class RecordingNamesError(StoneError):
    """Two different recordings have the same name."""

    code = "recordings_named_alike"

    def __init__(self, sequence_id: str, name: str) -> None:
        super().__init__(
            f"two different recordings of sequence {sequence_id} are called {name[:120]}; recordings of one run are "
            "told apart by their names: remove one and upload it under another, or name in recording_ids those meant"
        )


class ClockOffsetError(StoneError):
    """An offset of a clock is given that belongs to no recording of the run."""

    code = "bad_clock_offset"

    def __init__(self, recording: str, problem: str) -> None:
        super().__init__(f"a clock offset is given for {recording[:120]}, but {problem}")


class UnknownStagesError(StoneError):
    """Stages build on each other, so what is asked for must begin at the first."""

    code = "bad_stages"

    def __init__(self, stages: tuple[str, ...], known: tuple[str, ...]) -> None:
        asked = ", ".join(stages)[:120] or "none"
        super().__init__(f"stages {asked} cannot be run; ask for {known[0]}, or for {' and '.join(known)}")


class AlreadyProcessingError(StoneError):
    """A run is already in progress; `job_id` is that run."""

    code = "already_processing"

    def __init__(self, sequence_id: str, job_id: str) -> None:
        self.job_id = job_id
        super().__init__(
            f"sequence {sequence_id} is being processed otherwise by job {job_id}; wait for it, or cancel it first"
        )
