"""Previews: pictures and pages of a recording or of a processed sequence.

**Conventions.** The bytes are stored first (`prepared_previews`), outside transactions. The rows are written in the
caller's transaction and replace the existing rows. The files stay in the run's workspace until it is collected.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import delete
from sqlalchemy.orm import Session

from services.runtime.access import storage_quota
from services.runtime.orm import Preview, SequenceRow
from services.runtime.platform import Platform
from services.runtime.store.blobs import PreparedBlob, prepare
from stone_files.atomic import atomic_file

FOLDER = "previews"
MOST_PREVIEWS = 64


@dataclass(frozen=True)
class PreparedPreview:
    """A picture with stored bytes; link its blob before writing its row."""

    name: str
    media_type: str
    blob: PreparedBlob


@dataclass(frozen=True)
class PreviewSubject:
    """The subject of previews: a recording, or (by `recipe`) the results of the sequence."""

    sequence_id: str
    recording_id: str | None = None
    recipe: str = ""


def prepared_previews(
    platform: Platform, work: Path, drawn: Iterable[tuple[str, str, bytes]]
) -> tuple[PreparedPreview, ...]:
    """Store (name, media type, bytes), one after the other; at most `MOST_PREVIEWS`."""
    folder = work / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    return tuple(
        _prepare_preview(platform, folder, *picture) for picture, _ in zip(drawn, range(MOST_PREVIEWS), strict=False)
    )


def replace_previews(session: Session, shown: PreviewSubject, previews: Iterable[PreparedPreview]) -> None:
    """Replace the previews of `shown`; the new blobs are already linked.

    Their bytes count against the sequence's owner, under the recording's id, or the sequence's id if there is none.
    """
    mine = (Preview.recording_id == shown.recording_id, Preview.recipe == shown.recipe)
    gone = delete(Preview).where(Preview.sequence_id == shown.sequence_id, *mine).returning(Preview.size_bytes)
    more_bytes = -sum(session.scalars(gone))
    for preview in previews:
        more_bytes += preview.blob.size_bytes
        row = Preview(sequence_id=shown.sequence_id, recording_id=shown.recording_id, recipe=shown.recipe)
        row.name, row.media_type = preview.name, preview.media_type
        row.blob_sha256, row.size_bytes = preview.blob.sha256, preview.blob.size_bytes
        session.add(row)
    session.flush()
    owner_id = session.get_one(SequenceRow, shown.sequence_id).owner_id
    storage_quota.count(session, owner_id, more_bytes, shown.recording_id or shown.sequence_id, "previews")


def _prepare_preview(platform: Platform, folder: Path, name: str, media_type: str, content: bytes) -> PreparedPreview:
    path = folder / name
    with atomic_file(path) as staging:
        staging.write_bytes(content)
    return PreparedPreview(name, media_type, prepare(platform.store, platform.database, path, adopt=True))
