"""Links between traces of consecutive user actions, which may be hours apart.

    upload ← recording (register) ← processing (synchronise, label) ← export;  upload ← submission (open, part, join)

**Conventions.** A trace is one act of a person with all the jobs it caused; a link goes back to the act before it.
Nothing is looked up unless the span is sent.
"""

from opentelemetry.trace import get_current_span
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.orm import Job, RecordingFile, Upload
from services.runtime.telemetry.origins import link_to


def link_uploads_of(session: Session, recording_id: str) -> None:
    """What is done now is done to the files of this recording."""
    if get_current_span().is_recording():
        of_recording = RecordingFile.recording_id == recording_id
        sent = select(Upload.traceparent).join(RecordingFile, RecordingFile.upload_id == Upload.id)
        for traceparent in session.scalars(sent.where(of_recording)):
            link_to(traceparent)


def link_job(session: Session, job_id: str) -> None:
    """What is done now is done to what this job, or run, has made."""
    if get_current_span().is_recording():
        link_to(session.scalar(select(Job.traceparent).where(Job.id == job_id)) or "")
