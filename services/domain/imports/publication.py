"""The end of an import: the sequences of its scenes, the owner's quota, the draft splits.

**Conventions.** Part of the transaction that writes everything. Run and import are locked, then the owner, so that no
sequence of the owner is deleted between check and end (`delete_sequence` locks the owner too).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from services.domain.datasets.catalogue import labelled_sequences
from services.domain.datasets.splits import current_splits, errors_of, judged, lock_splits, replace_splits
from services.domain.imports.errors import existing_sequences
from services.domain.imports.kept_files import OF_NO_SCENE, count_kept
from services.runtime.access import storage_quota
from services.runtime.orm import DatasetImport, ImportedFile, SequenceRow
from services.runtime.orm.base import now_ns
from stone.splits.splits import PARTS, Split

AT_A_TIME = 1000
NO_SPLITS = "no_splits"


@dataclass(frozen=True)
class PublishedScene:
    """The sequence and label set of a scene; `size_bytes` count under the label set, 0 if it existed already."""

    sequence_id: str
    label_set_id: str
    size_bytes: int


def refuse_existing(session: Session, imported: DatasetImport, names: Sequence[str]) -> Mapping[str, SequenceRow]:
    """Return the owner's sequences with these names.

    Raises `sequences_exist` if there are any and the import does not add labels to them.
    """
    existing = dict[str, SequenceRow]()
    for start in range(0, len(names), AT_A_TIME):
        named = SequenceRow.name.in_(names[start : start + AT_A_TIME])
        alive = select(SequenceRow).where(SequenceRow.owner_id == imported.owner_id, SequenceRow.deleted_ns.is_(None))
        existing |= {row.name: row for row in session.scalars(alive.where(named))}
    if existing and imported.existing == "refuse":
        raise existing_sequences([name for name in names if name in existing])
    return existing


def sequences_of_scenes(session: Session, imported: DatasetImport) -> list[SequenceRow]:
    """Return the sequence of each scene, in order: an existing one with that name, or a new one. Locks the owner.

    Raises `sequences_exist`.
    """
    storage_quota.lock_owner(session, imported.owner_id)
    scenes = imported.scenes or []
    standing = refuse_existing(session, imported, [scene["name"] for scene in scenes])
    rows = [standing.get(scene["name"]) or _new_sequence(imported, scene) for scene in scenes]
    session.add_all(rows)
    session.flush()
    return rows


def _new_sequence(imported: DatasetImport, scene: Mapping[str, Any]) -> SequenceRow:
    """Return a new sequence; attributes given for the import take precedence over the dataset's region."""
    facts = dict(imported.facts)
    facts["region"] = facts.get("region") or scene.get("region", "")
    return SequenceRow(owner_id=imported.owner_id, name=scene["name"], **facts)


def end_import(session: Session, imported: DatasetImport, made: Sequence[PublishedScene], limit_bytes: int) -> None:
    """Release an uploaded archive, count the import's results against the owner, and record its sequences.

    Raises `quota_exceeded`.
    """
    if imported.upload_id is not None:
        storage_quota.release(session, imported.upload_id, "dataset imported")
    for scene in made:
        if scene.size_bytes:
            taken = (scene.size_bytes, scene.label_set_id, "import", limit_bytes)
            storage_quota.reserve(session, imported.owner_id, *taken)
    count_kept(session, imported, limit_bytes)
    of_scenes = (ImportedFile.import_id == imported.id, ImportedFile.scene != OF_NO_SCENE)
    session.execute(delete(ImportedFile).where(*of_scenes))
    imported.scenes = [
        {**record, "sequence_id": scene.sequence_id, "label_set_id": scene.label_set_id}
        for record, scene in zip(imported.scenes or [], made, strict=True)
    ]
    imported.blob_sha256, imported.finished_ns = None, now_ns()
    session.flush()


def follow_splits(session: Session, imported: DatasetImport) -> tuple[str, ...]:
    """Put the sequences of a finished import into the draft splits given by the dataset; return forbidding codes.

    If the rules forbid the result, the splits stay unchanged; if they were set, no codes are returned. Splits other
    than train, val and test are ignored; a dataset without these gives `no_splits`.
    """
    row = lock_splits(session)
    current = current_splits(session).split.parts
    parts = {
        record["sequence_id"]: part for record in imported.scenes or [] for part in PARTS if part in record["splits"]
    }
    if not parts:
        return (NO_SPLITS,)
    split = Split(
        *(
            (
                *(sequence_id for sequence_id in current[part] if sequence_id not in parts),
                *(sequence_id for sequence_id, of in parts.items() if of == part),
            )
            for part in PARTS
        )
    )
    refused = errors_of(judged(split, labelled_sequences(session)))
    if not refused:
        replace_splits(session, row, split)
    return tuple(sorted({finding.code for finding in refused}))
