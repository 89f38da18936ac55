"""Rows of a label set: its own, those of its artefacts, and those that locate the labels of each frame.

**Conventions.** Part of the caller's transaction. Blobs are linked, or held by another row, before.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import insert, select
from sqlalchemy.orm import Session

from services.labeler.child_answers import PackAnswer, PublicationAnswer
from services.runtime.code_version import code_version
from services.runtime.orm import Artefact, LabelledFrameRow, LabelSet, new_id
from services.runtime.source_digests import ResultKind

MEDIA_TYPES = {
    ".json": "application/json",
    ".parquet": "application/vnd.apache.parquet",
    ".ply": "model/ply",
    ".glb": "model/gltf-binary",
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".gif": "image/gif",
    ".mp4": "video/mp4",
}
OTHER_TYPE = "application/octet-stream"
LABELS = "labels/"  # prefix of the names of label packs


@dataclass(frozen=True)
class NewLabelSet:
    """A label set to write: its sequence, run, recipe, kind of code, and grid record.

    The grid record is None for the paper's grid.
    """

    sequence_id: str
    job_id: str
    recipe: str
    parameters: Mapping[str, Any]
    kind: ResultKind = "labels"
    grid: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class NewArtefact:
    """A stored file of a label set. For a pack, `pack` locates its frames."""

    name: str
    media_type: str
    blob_sha256: str
    size_bytes: int
    pack: PackAnswer | None = None


def standing_label_set(session: Session, sequence_id: str, recipe: str) -> LabelSet | None:
    """Return the sequence's label set with the same recipe, if any."""
    standing = select(LabelSet).where(LabelSet.sequence_id == sequence_id, LabelSet.recipe == recipe)
    return session.scalars(standing).one_or_none()


def write_label_set(session: Session, labels: NewLabelSet, answer: PublicationAnswer) -> LabelSet:
    row = LabelSet(
        id=new_id(),
        sequence_id=labels.sequence_id,
        job_id=labels.job_id,
        recipe=labels.recipe,
        parameters=dict(labels.parameters),
        code_version=code_version(labels.kind),
        frames=len(answer.tokens),
        grid=dict(labels.grid) if labels.grid is not None else None,
        **answer.totals.model_dump(),
    )
    session.add(row)
    session.flush()
    return row


def write_artefact(session: Session, label_set_id: str, file: NewArtefact, answer: PublicationAnswer) -> None:
    row = Artefact(id=new_id(), label_set_id=label_set_id, name=file.name, media_type=file.media_type)
    row.blob_sha256, row.size_bytes = file.blob_sha256, file.size_bytes
    session.add(row)
    session.flush()
    if file.pack is None:
        return
    of_pack = {"label_set_id": label_set_id, "pack_id": row.id}
    rows = [
        {**of_pack, **answer.frame(ordinal), "offset_bytes": offset, "length_bytes": length, "sha256": digest}
        for ordinal, (offset, length, digest) in enumerate(file.pack.ranges, start=file.pack.first)
    ]
    session.execute(insert(LabelledFrameRow).returning(LabelledFrameRow.ordinal), rows)  # many rows per statement
