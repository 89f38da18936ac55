"""The stage that reads a recording once and keeps it: received → registered or refused.

**Conventions.** The upload's file stays until a blob holds its bytes, so an attempt killed anywhere is repeated from
the start; the sweeper removes the file afterwards. A refusal is written before the job fails by it, in the same words.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy.orm import Session

from services.ingest.errors import IngestError
from services.ingest.inspection import inspect
from services.ingest.inspection_record import inspection_record
from services.ingest.named import named
from services.ingest.recording_errors import RecordingChangedError, RecordingFileMissingError, RecordingRefusedError
from services.runtime import quota
from services.runtime.blobs import PreparedBlob, link, prepare
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.specs import Attempt, Outcome
from services.runtime.orm import Blob, Recording
from services.runtime.platform import Platform
from services.runtime.uploads import upload_file
from stone.errors import StoneError
from stone.findings import Finding

NAMES_FOLDER = "names"


@dataclass(frozen=True)
class _Received:
    """What the rows say of the recording; `path` is where its bytes lie now."""

    recording_id: str
    upload_id: str
    filename: str
    sha256: str
    path: Path


def register(platform: Platform, attempt: Attempt) -> Outcome:
    """Inspect the recording and keep it as a blob. Raises the `BAG-*` refusals, `RecordingChangedError`."""
    received = _received(platform, str(attempt.arguments["recording_id"]))
    attempt.progress("inspect", 0, 2)
    try:
        path = named(platform.settings.root / NAMES_FOLDER, received.path, received.filename)
        inspection = inspect(path)
        attempt.progress("keep", 1, 2)
        prepared = prepare(platform.store, platform.database, received.path, adopt=True)
        if prepared.sha256 != received.sha256:
            raise RecordingChangedError(received.filename, prepared.sha256, received.sha256)
    except (IngestError, RecordingChangedError) as error:  # a store that is full or away is no fault of the recording
        _refuse(platform, received, error)
        raise
    record = inspection_record(inspection)
    attempt.progress("keep", 2, 2)
    attempt.log("inspected", topics=len(inspection.topics), findings=len(inspection.findings))
    result = {"recording_id": received.recording_id, "topics": len(inspection.topics)}
    return Outcome(result, commit=lambda session: _register(session, received, prepared, record))


def _received(platform: Platform, recording_id: str) -> _Received:
    with platform.database.reading() as session:
        recording = session.get(Recording, recording_id)
        blob = session.get(Blob, recording.blob_sha256) if recording and recording.blob_sha256 else None
    if recording is None:
        raise JobCancelledError("its recording was deleted")
    upload_id = recording.upload_id or ""
    path = platform.store.local(blob.object_key) if blob else upload_file(platform.settings, upload_id)
    if not path.is_file():
        if recording.state == "refused":  # by an attempt that was killed before it could say so
            raise RecordingRefusedError(recording.filename, recording.findings[0]["message"])
        raise RecordingFileMissingError(recording.filename, upload_id)
    return _Received(recording_id, upload_id, recording.filename, recording.sha256, path)


def _register(session: Session, received: _Received, prepared: PreparedBlob, record: dict[str, Any]) -> None:
    recording = session.get(Recording, received.recording_id, with_for_update=True)
    if recording is None:
        raise JobCancelledError("its recording was deleted")
    recording.blob_sha256 = link(session, prepared).sha256
    recording.state = "registered"
    recording.findings = record.pop("findings")
    recording.inspection = record


def _refuse(platform: Platform, received: _Received, error: StoneError) -> None:
    """Write the refusal down, give the owner's bytes back, remove the file."""
    with platform.database.transaction() as session:
        recording = session.get(Recording, received.recording_id, with_for_update=True)
        if recording is None or recording.state != "received":
            return
        recording.state = "refused"
        recording.findings = [Finding(error.code, "error", "", str(error)[:2000]).as_record()]
        quota.release(session, received.upload_id, "recording refused")
    received.path.unlink(missing_ok=True)
