"""What the samples of a label set are read from: the recording it was made of, or the source that was imported with it.

**Conventions.** A label set is imported where it has the artefact `source/index.npz`: the index of the files of its
scene as they were published (`services/runtime/store/packs.py`), which lie in `source/000000.pack` and on; its labels
are among them only if their files are of another layout than ours. Files of an archive that was imported in place stay
there: `source/placed.npz` says where they lie in it, and the label set's `source_place` where it lies. Samples come
from the source and never from a recording, whatever its sequence has beside.
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
    """The objects of the store that hold a source; of one in place also the index of its files, and its archive."""

    index_key: str
    pack_keys: tuple[str, ...]
    placed: tuple[str, RecordingPlace] | None


def is_imported(session: Session, label_set_id: str) -> bool:
    index = select(Artefact.id).where(Artefact.label_set_id == label_set_id, Artefact.name == SOURCE_INDEX)
    return session.scalar(index) is not None


def has_samples(session: Session, sequence_id: str, label_set_id: str) -> bool:
    """Whether what its sensors measured is still there: its source, or else a recording of its sequence."""
    registered = select(Recording.id).where(Recording.sequence_id == sequence_id, Recording.state == "registered")
    return is_imported(session, label_set_id) or session.scalar(registered.limit(1)) is not None


def located_source(session: Session, label_set_id: str) -> LocatedSource | None:
    """The objects that hold the source of an imported label set; None of one that was made here."""
    of_labels = select(Artefact.name, Blob.object_key).join(Blob, Blob.sha256 == Artefact.blob_sha256)
    of_source = of_labels.where(Artefact.label_set_id == label_set_id, Artefact.name.like(f"{SOURCE}/%"))
    keys = {name: key for name, key in session.execute(of_source)}
    if SOURCE_INDEX not in keys:
        return None
    packs = (keys[name] for name in sorted(keys) if name.endswith(".pack"))
    record = session.scalar(select(LabelSet.source_place).where(LabelSet.id == label_set_id))
    placed = None if record is None else (keys[SOURCE_PLACED], RecordingPlace.of_record(record))
    return LocatedSource(keys[SOURCE_INDEX], tuple(packs), placed)
