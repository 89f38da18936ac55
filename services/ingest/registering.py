"""The stage that reads a recording once and keeps it: received → registered or refused.

**Conventions.** The uploads' files stay until blobs hold their bytes, so an attempt killed anywhere is repeated from
the start; the sweeper removes the files afterwards. A refusal is written before the job fails by it, in the same words.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy.orm import Session

from services.ingest.errors import IngestError
from services.ingest.inspection import inspect
from services.ingest.inspection_record import inspection_record
from services.ingest.named import named, named_folder
from services.ingest.recording_errors import RecordingChangedError, RecordingFileMissingError, RecordingRefusedError
from services.runtime import quota
from services.runtime.blobs import PreparedBlob, link, prepare
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.specs import Attempt, Outcome
from services.runtime.orm import Blob, Recording, RecordingFile
from services.runtime.platform import Platform
from services.runtime.uploads import upload_file
from stone.errors import StoneError
from stone.findings import Finding

NAMES_FOLDER = "names"


@dataclass(frozen=True)
class _File:
    """What a row says of one file; `path` is where its bytes lie now."""

    row_id: str
    upload_id: str
    filename: str
    sha256: str
    path: Path


@dataclass(frozen=True)
class _Received:
    """What the rows say of the recording."""

    recording_id: str
    name: str
    files: tuple[_File, ...]

    def named(self, folder: Path) -> Path:
        """The bag as its owner named it: a file, or a folder with the files."""
        if len(self.files) == 1:
            return named(folder, self.files[0].path, self.name)
        return named_folder(folder, [(file.path, file.filename) for file in self.files], self.name)


def register(platform: Platform, attempt: Attempt) -> Outcome:
    """Inspect the recording and keep it as blobs. Raises the `BAG-*` refusals, `RecordingChangedError`."""
    received = _received(platform, str(attempt.arguments["recording_id"]))
    attempt.progress("inspect", 0, 2)
    try:
        inspection = inspect(received.named(platform.settings.root / NAMES_FOLDER))
        attempt.progress("keep", 1, 2)
        prepared = {file.row_id: _prepared(platform, file) for file in received.files}
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
        if recording is None:
            raise JobCancelledError("its recording was deleted")
        files = tuple(_file(session, platform, file) for file in recording.files)
    for file in files:
        if file.path.is_file():
            continue
        if recording.state == "refused":  # by an attempt that was killed before it could say so
            raise RecordingRefusedError(recording.filename, recording.findings[0]["message"])
        raise RecordingFileMissingError(file.filename, file.upload_id)
    return _Received(recording_id, recording.filename, files)


def _file(session: Session, platform: Platform, row: RecordingFile) -> _File:
    blob = session.get(Blob, row.blob_sha256) if row.blob_sha256 else None
    upload_id = row.upload_id or ""
    path = platform.store.local(blob.object_key) if blob else upload_file(platform.settings, upload_id)
    return _File(row.id, upload_id, row.filename, row.sha256, path)


def _prepared(platform: Platform, file: _File) -> PreparedBlob:
    """Raises `RecordingChangedError`."""
    prepared = prepare(platform.store, platform.database, file.path, adopt=True)
    if prepared.sha256 != file.sha256:
        raise RecordingChangedError(file.filename, prepared.sha256, file.sha256)
    return prepared


def _register(
    session: Session, received: _Received, prepared: Mapping[str, PreparedBlob], record: dict[str, Any]
) -> None:
    recording = session.get(Recording, received.recording_id, with_for_update=True)
    if recording is None:
        raise JobCancelledError("its recording was deleted")
    blobs = {blob.sha256: blob for blob in prepared.values()}
    for _sha256, blob in sorted(blobs.items()):
        link(session, blob)
    for file in recording.files:
        file.blob_sha256 = prepared[file.id].sha256
    recording.state = "registered"
    recording.findings = record.pop("findings")
    recording.inspection = record


def _refuse(platform: Platform, received: _Received, error: StoneError) -> None:
    """Write the refusal down, give the owner's bytes back, remove the files."""
    with platform.database.transaction() as session:
        recording = session.get(Recording, received.recording_id, with_for_update=True)
        if recording is None or recording.state != "received":
            return
        recording.state = "refused"
        recording.findings = [Finding(error.code, "error", "", str(error)[:2000]).as_record()]
        for file in received.files:
            quota.release(session, file.upload_id, "recording refused")
    for file in received.files:
        file.path.unlink(missing_ok=True)
