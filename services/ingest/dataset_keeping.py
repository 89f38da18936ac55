"""The stage that keeps the uploaded tar of a dataset as a blob, where workers of the labeler find it.

**Conventions.** The upload's file stays until the blob's row is written, so an attempt killed anywhere is repeated; the
sweeper removes the file where this could not. Nobody opens the tar here: its bytes are hashed and stored.
"""

from services.domain.imports.requests import INDEX, import_of_attempt, kept_import
from services.ingest.errors import RecordingChangedError, RecordingFileMissingError
from services.runtime.jobs.specs import Attempt, JobSpec, Outcome
from services.runtime.orm import DatasetImport, Upload
from services.runtime.platform import Platform
from services.runtime.store.blobs import PreparedBlob, link, prepare
from services.runtime.uploads.backends import backend_of, remove_bytes


def keep_dataset(platform: Platform, attempt: Attempt) -> Outcome:
    """Keep the tar. Raises `JobCancelledError`, `RecordingFileMissingError`, `RecordingChangedError`, what the store
    raises."""
    imported = import_of_attempt(platform, attempt)
    if imported.blob_sha256 is None:
        attempt.progress("keep", 0, 1)
        _keep(platform, attempt, imported)
        attempt.log("kept", filename=imported.name, size_bytes=imported.size_bytes)
    return Outcome({"size_bytes": imported.size_bytes}, then=(JobSpec(INDEX),))


def _keep(platform: Platform, attempt: Attempt, imported: DatasetImport) -> None:
    with platform.database.reading() as session:
        upload = session.get_one(Upload, imported.upload_id)
    try:
        with backend_of(platform, upload).local(upload) as path:
            prepared = prepare(platform.store, platform.database, path, adopt=True)
            _write(platform, attempt, imported, prepared)
    except FileNotFoundError as error:
        raise RecordingFileMissingError(upload.filename, upload.id) from error
    remove_bytes(platform, [upload.id])


def _write(platform: Platform, attempt: Attempt, imported: DatasetImport, prepared: PreparedBlob) -> None:
    """Raises `RecordingChangedError`, `JobCancelledError`."""
    if prepared.sha256 != imported.sha256:
        raise RecordingChangedError(imported.name, prepared.sha256, imported.sha256)
    with platform.database.transaction() as session:
        kept_import(session, attempt).blob_sha256 = link(session, prepared).sha256
