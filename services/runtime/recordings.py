"""A recording comes to be of an upload, once, and goes again with its bytes.

**Conventions.** Each function is part of the caller's transaction and locks the sequence's row first
(`services/runtime/processing.py`). The bytes of a recording are counted against its owner under the upload's id.
"""

from contextlib import suppress

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime import quota
from services.runtime.jobs.errors import JobStateError
from services.runtime.jobs.specs import TERMINAL
from services.runtime.jobs.steering import cancel
from services.runtime.orm import Job, Recording, Sequence
from services.runtime.processing import PROCESS, REGISTER, lock_sequence, register
from services.runtime.uploads import consume
from stone.errors import StoneError

PURPOSE = "recording"


class ForeignTargetError(StoneError):
    """The upload was declared for another sequence."""

    code = "wrong_upload_target"

    def __init__(self, upload_id: str, declared: str, wanted: str) -> None:
        super().__init__(f"upload {upload_id} was declared for sequence {declared}, not for {wanted}")


class RecordingInUseError(StoneError):
    """A run reads the recording now."""

    code = "recording_in_use"

    def __init__(self, recording_id: str, job_id: str) -> None:
        super().__init__(f"recording {recording_id} is read by job {job_id}; wait for it, or cancel it first")


def add_recording(session: Session, sequence: Sequence, upload_id: str, uploader_id: str) -> tuple[Recording, Job]:
    """Use up a complete upload of the uploader's: its recording, and the job that reads and keeps it.

    Raises `SequenceDeletedError`, what `uploads.consume` raises, `ForeignTargetError`, `QueueDrainingError`.
    """
    sequence = lock_sequence(session, sequence.id)
    upload = consume(session, upload_id, uploader_id, PURPOSE)
    if upload.target_id not in ("", sequence.id):
        raise ForeignTargetError(upload_id, upload.target_id, sequence.id)
    recording = Recording(
        sequence_id=sequence.id,
        upload_id=upload.id,
        filename=upload.filename,
        size_bytes=upload.length_bytes,
        sha256=upload.sha256,
    )
    session.add(recording)
    session.flush()
    return recording, register(session, recording)


def remove_recording(session: Session, recording: Recording) -> None:
    """Take the recording from its sequence; its bytes are given back, what was made of it stays.

    Raises `SequenceDeletedError`, `RecordingInUseError`.
    """
    lock_sequence(session, recording.sequence_id)
    for run in _alive(session, recording.sequence_id):
        if run.kind == PROCESS and run.arguments["recording_id"] == recording.id:
            raise RecordingInUseError(recording.id, run.id)
        if run.kind == REGISTER and run.arguments["recording_id"] == recording.id:
            with suppress(JobStateError):  # it ended while we waited for its row
                cancel(session, run.id, "its recording was deleted")
    session.delete(recording)
    session.flush()
    if recording.upload_id is not None:
        quota.release(session, recording.upload_id, "recording deleted")


def _alive(session: Session, sequence_id: str) -> list[Job]:
    runs = select(Job).where(Job.sequence_id == sequence_id, Job.id == Job.root_id, Job.state.not_in(TERMINAL))
    return list(session.scalars(runs.execution_options(populate_existing=True)))
