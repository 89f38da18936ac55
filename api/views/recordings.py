"""Recordings as the API and the pages show them: rows become bodies."""

from sqlalchemy.orm import Session

from api.schemas.sequences.recordings import PlaceItem, RecordingDetail, RecordingFileItem, RecordingItem
from api.views.preview_files import previews_of_recording
from services.runtime.orm import Recording


def recording_item(row: Recording) -> RecordingItem:
    """Return a recording as a list shows it."""
    return RecordingItem.of(row, files=_file_items(row), place=PlaceItem.recorded(row.place))


def recording_detail(session: Session, row: Recording) -> RecordingDetail:
    """Return a recording with its inspection."""
    return RecordingDetail.of(
        row, files=_file_items(row), place=PlaceItem.recorded(row.place), previews=previews_of_recording(session, row)
    )


def _file_items(row: Recording) -> list[RecordingFileItem]:
    return [RecordingFileItem.of(file, is_recovered=file.recovered_blob_sha256 is not None) for file in row.files]


def _place_item(row: Recording) -> PlaceItem | None:
    return None if row.place is None else PlaceItem(root=row.place["root"], path=row.place["path"])
