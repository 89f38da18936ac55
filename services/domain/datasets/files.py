"""The files of a part of a dataset version, and the blob and offset of each.

**Conventions.** `gts/<sequence>/<frame_token>/labels.npz` in the order of frames, then `sequences/<sequence>/…`, last
`sha256sum.txt`, which covers all other files. Files stay in their blobs: a version copies nothing. Only tars are made
of them, so no CRC is kept.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from hashlib import sha256

import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.datasets.catalogue import CatalogueSequence
from services.domain.sequences.label_sources import SOURCE
from services.runtime.orm import Artefact, LabelledFrameRow
from services.runtime.store.packs import SUMS, PackedFiles
from stone_files.archives import check_names

ELSEWHERE = ("labels/", "scene/", f"{SOURCE}/")


@dataclass(frozen=True)
class DatasetFile:
    """A file: bytes [offset, offset + size) of a blob."""

    name: str
    size_bytes: int
    sha256: str
    blob_sha256: str
    offset_bytes: int = 0

    def as_record(self) -> dict[str, str | int]:
        return {"name": self.name, "size_bytes": self.size_bytes, "sha256": self.sha256}


def files_of(session: Session, labelled: Iterable[CatalogueSequence]) -> tuple[DatasetFile, ...]:
    """Return the files of these sequences, without checksums. Raises `bad_member`."""
    files = tuple(file for sequence in labelled for file in (*_labels(session, sequence), *_others(session, sequence)))
    check_names([*(file.name for file in files), SUMS])
    return files


def sums_of(files: Iterable[DatasetFile]) -> bytes:
    """Return a checksum list for `sha256sum -c`."""
    return "".join(f"{file.sha256}  {file.name}\n" for file in files).encode("ascii")


def sums_file(content: bytes) -> DatasetFile:
    digest = sha256(content).hexdigest()
    return DatasetFile(SUMS, len(content), digest, digest)


def packed(files: Sequence[DatasetFile]) -> tuple[PackedFiles, tuple[str, ...]]:
    """Return the files as an index, and the blobs to which its numbers refer."""
    blobs = tuple(dict.fromkeys(file.blob_sha256 for file in files))
    number = {blob: ordinal for ordinal, blob in enumerate(blobs)}
    digests = b"".join(bytes.fromhex(file.sha256) for file in files)
    index = PackedFiles(
        tuple(file.name for file in files),
        np.array([file.size_bytes for file in files], np.int64),
        np.zeros(len(files), np.uint32),
        np.frombuffer(digests, np.uint8).reshape(-1, 32),
        np.array([number[file.blob_sha256] for file in files], np.int32),
        np.array([file.offset_bytes for file in files], np.int64),
    )
    return index, blobs


def _labels(session: Session, labelled: CatalogueSequence) -> Iterator[DatasetFile]:
    frames = (
        select(LabelledFrameRow, Artefact.blob_sha256)
        .join(Artefact, Artefact.id == LabelledFrameRow.pack_id)
        .where(LabelledFrameRow.label_set_id == labelled.labels.id)
        .order_by(LabelledFrameRow.ordinal)
    )
    for frame, blob in session.execute(frames):
        name = f"gts/{labelled.sequence.name}/{frame.token}/labels.npz"
        yield DatasetFile(name, frame.length_bytes, frame.sha256, blob, frame.offset_bytes)


def _others(session: Session, labelled: CatalogueSequence) -> Iterator[DatasetFile]:
    """Yield the other files published with the labels.

    Excluded are packs (frame files are ranges of them), the viewer's scene, and the measurements from which inputs are
    made.
    """
    artefacts = select(Artefact).where(Artefact.label_set_id == labelled.labels.id).order_by(Artefact.name)
    for row in session.scalars(artefacts):
        if not row.name.startswith(ELSEWHERE):
            name = f"sequences/{labelled.sequence.name}/{row.name}"
            yield DatasetFile(name, row.size_bytes, row.blob_sha256, row.blob_sha256)
