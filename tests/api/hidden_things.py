"""What nobody but administrators may be told of a hidden phase, and where it hides in an answer.

**Conventions.** Secrets are found in the rows and the store, not in what the routes say. Bytes are looked for in every
layer of an answer (archives, compressed streams, tables), digests in hex and base64, numbers as they are written.
"""

import base64
import gzip
import io
import json
import re
import tarfile
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import pyarrow
import pyarrow.parquet
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.orm import (
    Artefact,
    Blob,
    DatasetMember,
    DatasetPack,
    GroundTruthRow,
    LabelledFrameRow,
    LabelSet,
    Score,
    SequenceRow,
    SubmissionRow,
)
from testing.worlds.benchmark_world import CANARY, World

NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?(?![\w.])")
WINDOW_BYTES = 48
LARGE = 10_000
"""Counts below this may be anything."""
DEEPEST = 4


@dataclass(frozen=True)
class Secrets:
    """Byte strings, texts and numbers that no answer may hold."""

    blobs: tuple[bytes, ...]
    texts: frozenset[str]
    numbers: frozenset[float]

    def found_in(self, headers: str, body: bytes) -> list[str]:
        """What of it is there, for people."""
        layers = _layers(body)
        whole = "\n".join([headers, *filter(None, map(_as_text, layers))])
        told = [f"bytes {secret[:16].hex()}…" for secret in self.blobs if any(secret in layer for layer in layers)]
        told += [text for text in self.texts if text in whole]
        return told + [str(number) for number in {float(one) for one in NUMBER.findall(whole)} & self.numbers]


@lru_cache(maxsize=1000)
def _layers(body: bytes) -> tuple[bytes, ...]:
    """Most answers come more than once."""
    return tuple(unwrapped(body))


def unwrapped(body: bytes, depth: int = 0) -> Iterator[bytes]:
    """The bytes as they are, and as whoever opens them sees them."""
    yield body
    if depth < DEEPEST:
        for inner in _opened(body):
            yield from unwrapped(inner, depth + 1)


def secrets_of(session: Session, world: World) -> Secrets:
    """Of the phase `test`."""
    names = list(world.grids["test"])
    members = (
        select(LabelSet).join(SequenceRow, SequenceRow.id == LabelSet.sequence_id).where(SequenceRow.name.in_(names))
    )
    label_sets = list(session.scalars(members))
    ids = [one.id for one in label_sets]
    frames = list(session.scalars(select(LabelledFrameRow).where(LabelledFrameRow.label_set_id.in_(ids))))
    scores = list(session.scalars(select(Score).join(SubmissionRow).where(SubmissionRow.phase_id == world.test)))
    kept = set(session.scalars(select(Artefact.blob_sha256).where(Artefact.label_set_id.in_(ids))))
    kept |= {sha for score in scores for sha in (score.confusions_sha256, score.spectra_sha256)}
    kept |= set(session.scalars(select(GroundTruthRow.pack_sha256).where(GroundTruthRow.phase_id == world.test)))
    kept |= set(session.scalars(select(DatasetPack.blob_sha256).where(DatasetPack.part == "test")))
    kept -= set(session.scalars(select(Artefact.blob_sha256).where(Artefact.name == "grid.json")))  # a public fact
    keys = session.scalars(select(Blob.object_key).where(Blob.sha256.in_(kept)))
    digests = kept | {frame.sha256 for frame in frames} | {score.content_sha256 for score in scores}
    columns = ("free_voxels", "t_voxels", "p_voxels", "n_voxels", "held_out_m")
    counts = [getattr(one, name) for one in label_sets for name in columns]
    counts += [one.t_voxels for one in session.scalars(select(DatasetMember).where(DatasetMember.name.in_(names)))]
    others = session.scalars(select(Score).join(SubmissionRow).where(SubmissionRow.phase_id != world.test))
    open_numbers = {number for score in others for number in _numbers_in(score.record)}  # of these nothing follows
    numbers = {number for score in scores for number in _numbers_in(score.record)} - open_numbers
    return Secrets(
        tuple(_windows(world)),
        frozenset(keys) | {form for digest in digests for form in _written(digest)},
        frozenset(float(one) for one in [*counts, *numbers] if _is_conclusive(one)),
    )


def _as_text(layer: bytes) -> str:
    """Empty where it is none: numbers and digests are not looked for in pictures."""
    try:
        return layer.decode("utf-8")
    except UnicodeDecodeError:
        return ""


def _windows(world: World) -> Iterator[bytes]:
    """Of each hidden label file something from its middle, of each grid the canary and what surrounds it."""
    yield CANARY.tobytes()
    for content in world.hidden_files:
        middle = len(content) // 2
        yield content[middle : middle + WINDOW_BYTES]


def _written(digest: str | None) -> tuple[str, ...]:
    """A sha256 as headers and bodies may write it."""
    if not digest:
        return ()
    raw = bytes.fromhex(digest)
    return digest, base64.b64encode(raw).decode(), base64.urlsafe_b64encode(raw).decode().rstrip("=")


def _is_conclusive(number: float | None) -> bool:
    """Exact ratios and large counts; a ratio that rounding does not change is public, and a small count is anything."""
    if number is None or isinstance(number, bool):
        return False
    return number >= LARGE if float(number).is_integer() else round(number, 4) != number


def _numbers_in(record: Any) -> Iterator[float]:
    if isinstance(record, dict):
        record = list(record.values())
    if isinstance(record, list):
        for one in record:
            yield from _numbers_in(one)
    elif isinstance(record, int | float) and not isinstance(record, bool):
        yield record


def _opened(body: bytes) -> Iterator[bytes]:
    if body[:2] == b"PK" and zipfile.is_zipfile(io.BytesIO(body)):
        with zipfile.ZipFile(io.BytesIO(body)) as zipped:
            yield from (zipped.read(name) for name in zipped.namelist())
    elif body[257:262] == b"ustar":
        with tarfile.open(fileobj=io.BytesIO(body)) as archive:
            files = [archive.extractfile(member) for member in archive if member.isfile()]
            yield from (file.read() for file in files if file is not None)
    elif body[:2] == b"\x1f\x8b":
        yield gzip.decompress(body)
    elif body[:4] == b"PAR1" and body[-4:] == b"PAR1" and len(body) > 12:
        try:
            table = pyarrow.parquet.read_table(io.BytesIO(body))
        except pyarrow.ArrowInvalid:
            return
        yield json.dumps(table.to_pylist(), default=str).encode()
    elif body[:1] == b"\x78":
        try:
            yield zlib.decompress(body)
        except zlib.error:
            return
