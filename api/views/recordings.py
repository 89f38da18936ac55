"""Recordings as the API and the pages show them: rows become bodies."""

from sqlalchemy.orm import Session

from api.schemas.base import instant
from api.schemas.sequences.calibrations import FindingItem
from api.schemas.sequences.recordings import RecordingDetail, RecordingFileItem, RecordingItem
from api.views.preview_files import previews_of_recording
from services.runtime.orm import Recording, RecordingFile


def recording_item(row: Recording) -> RecordingItem:
    """A recording as a list shows it."""
    return RecordingItem(
        id=row.id,
        sequence_id=row.sequence_id,
        filename=row.filename,
        size_bytes=row.size_bytes,
        sha256=row.sha256,
        files=[_file_item(file) for file in row.files],
        state=row.state,
        findings=[FindingItem(**finding) for finding in row.findings],
        created_at=instant(row.created_ns),
    )


def recording_detail(session: Session, row: Recording) -> RecordingDetail:
    """A recording with what its inspection said."""
    item, previews = dict(recording_item(row)), previews_of_recording(session, row)
    return RecordingDetail(**item, inspection=row.inspection, quality=row.quality, previews=previews)


def _file_item(row: RecordingFile) -> RecordingFileItem:
    return RecordingFileItem(
        upload_id=row.upload_id,
        filename=row.filename,
        size_bytes=row.size_bytes,
        sha256=row.sha256,
        is_recovered=row.recovered_blob_sha256 is not None,
    )
