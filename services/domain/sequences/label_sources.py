"""The source of a label set's samples: the recordings from which it was made, or the imported source.

**Conventions.** A label set is imported if it has the artefact `source/index.npz`: the index of its scene's published
files (`services/runtime/store/packs.py`), which are in `source/000000.pack` and following packs. Its labels are among
these files only if their layout differs from the platform's. Files of an archive imported in place stay there:
`source/placed.npz` has their offsets in the archive, and the label set's `source_place` its location. Samples of an
imported label set always come from its source, even if its sequence has recordings.
"""

from dataclasses import dataclass

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.orm import Artefact, Blob, LabelSet, Recording
from stone_recordings.sync.stored_recording import RecordingPlace

SOURCE = "source"
SOURCE_INDEX, SOURCE_PLACED = f"{SOURCE}/index.npz", f"{SOURCE}/placed.npz"


@dataclass(frozen=True)
class LocatedSource:
    """The objects of a source in the store; for a source in place also the index of its files, and its archive."""

    index_key: str
    pack_keys: tuple[str, ...]
    placed: tuple[str, RecordingPlace] | None


def is_imported(session: Session, label_set_id: str) -> bool:
    index = select(Artefact.id).where(Artefact.label_set_id == label_set_id, Artefact.name == SOURCE_INDEX)
    return session.scalar(index) is not None


def has_samples(session: Session, sequence_id: str, label_set_id: str) -> bool:
    """Return whether the sensor data still exist: the source, or else a recording of the sequence."""
    registered = select(Recording.id).where(Recording.sequence_id == sequence_id, Recording.state == "registered")
    return is_imported(session, label_set_id) or session.scalar(registered.limit(1)) is not None


def located_source(session: Session, label_set_id: str) -> LocatedSource | None:
    """Return the objects of an imported label set's source; None for a label set made by the platform."""
    of_labels = select(Artefact.name, Blob.object_key).join(Blob, Blob.sha256 == Artefact.blob_sha256)
    of_source = of_labels.where(Artefact.label_set_id == label_set_id, Artefact.name.like(f"{SOURCE}/%"))
    keys = {name: key for name, key in session.execute(of_source)}
    if SOURCE_INDEX not in keys:
        return None
    packs = (keys[name] for name in sorted(keys) if name.endswith(".pack"))
    record = session.scalar(select(LabelSet.source_place).where(LabelSet.id == label_set_id))
    placed = None if record is None else (keys[SOURCE_PLACED], RecordingPlace.of_record(record))
    return LocatedSource(keys[SOURCE_INDEX], tuple(packs), placed)
