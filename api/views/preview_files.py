"""Previews of recordings and sequences: their list items and their files."""

from collections.abc import Iterable
from typing import Annotated, Any

from fastapi import Path
from sqlalchemy import BindParameter, Select, func, select
from sqlalchemy.orm import Session, aliased

from api.errors import NotFoundError
from api.files import StoredFile, read_whole
from api.schemas.sequences.sequences import PreviewItem
from services.domain.viewer.frame_picture import recoloured
from services.runtime.database.rows import KeptSelect, parameter
from services.runtime.orm import Blob, LabelSet, Preview, Recording, SequenceRow
from services.runtime.store.protocol import Store
from stone.labels.class_colours import ColourName

PreviewName = Annotated[
    str, Path(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,127}\.(png|jpg|json|html)$", examples=["cameras.jpg"])
]
PictureName = Annotated[
    str, Path(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,127}\.(png|jpg)$", examples=["bev.png", "overlay_CAM_FRONT.jpg"])
]
PICTURE_TYPES = ("image/png", "image/jpeg")
PREVIEW_TYPES = ("image/png", "image/jpeg", "application/json", "text/html")


def previews_of_recording(session: Session, recording: Recording) -> list[PreviewItem]:
    """Return the previews of a recording by name."""
    return _items(session.scalars(_of_recording(recording)))


def previews_of_sequence(session: Session, sequence_id: str, labels: LabelSet | None) -> list[PreviewItem]:
    """Return the previews by name: those of the run that made the active labels, else of the newest run."""
    recipe = None if labels is None else labels.recipe
    return _items(_PREVIEWS.rows(session, {"sequence": sequence_id, "recipe": recipe}))


def recording_preview(session: Session, recording: Recording, name: str) -> StoredFile:
    """Return a preview of the recording. Raises `NotFoundError`."""
    return _file(session, _of_recording(recording), name, recording.filename)


def sequence_preview(session: Session, sequence: SequenceRow, labels: LabelSet | None, name: str) -> StoredFile:
    """Return a preview of the sequence. Raises `NotFoundError`."""
    return _file(session, _of_sequence(session, sequence, labels), name, sequence.name)


def picture_in(store: Store, file: StoredFile, colours: ColourName) -> bytes:
    """Return a stored picture with the class colours of this palette; unchanged if it has no palette of ours.

    Reads the store, so it must not run within a transaction. Raises `ObjectMissingError`.
    """
    return recoloured(read_whole(store, file), colours)


def _of_recording(recording: Recording) -> Select[Preview]:
    return select(Preview).where(Preview.recording_id == recording.id).order_by(Preview.name)


def _of_sequence(session: Session, sequence: SequenceRow, labels: LabelSet | None) -> Select[Preview]:
    recipe = None if labels is None else labels.recipe
    return select(Preview).where(*_shown(sequence.id, recipe))


def _shown(sequence_id: str | BindParameter[str], recipe: str | BindParameter[str] | None) -> tuple[Any, ...]:
    """Return the conditions for the previews of this recipe; without a recipe, of the newest labels."""
    other = aliased(Preview)
    of_sequence = (other.sequence_id == sequence_id, other.recording_id.is_(None))
    newest = select(other.recipe).where(*of_sequence).order_by(other.id.desc()).limit(1).scalar_subquery()
    is_of_recipe = Preview.recipe == func.coalesce(recipe, newest)
    return (Preview.sequence_id == sequence_id, Preview.recording_id.is_(None), is_of_recipe)


_SAID = (Preview.name, Preview.media_type, Preview.size_bytes, Preview.blob_sha256)
_OF_SEQUENCE = _shown(parameter("sequence"), parameter("recipe"))
_PREVIEWS = KeptSelect(select(*_SAID).where(*_OF_SEQUENCE).order_by(Preview.name))


def _items(rows: Iterable[Any]) -> list[PreviewItem]:
    return [PreviewItem.of(row, sha256=row.blob_sha256) for row in rows]


def _file(session: Session, found: Select[Preview], name: str, of: str) -> StoredFile:
    preview = session.scalars(found.where(Preview.name == name)).one_or_none()
    if preview is None:
        raise NotFoundError("preview", name)
    blob = session.get_one(Blob, preview.blob_sha256)
    return StoredFile(blob.object_key, blob.size_bytes, blob.sha256, preview.media_type, f"{of}-{name}")
