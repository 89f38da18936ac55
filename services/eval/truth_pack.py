"""A whole ground truth in one file: its bit planes frame by frame, so that any frame can be read alone.

**Conventions.** The file consists of the magic, the packed planes of each frame in the order of the manifest, an index,
the start of the index and the magic again; little-endian. The index is an npz of `tokens`, `offsets`, `counts`, `crc32`
and `other_supports`. It has `grid` (JSON) if it is not the paper's, and `late` if late voxels are known. Packs of
earlier versions have no `other_supports`. A frame consists of the `changes` and `columns` of
`stone.scoring.plane_runs`. On real labels it unpacks in a quarter of LZ4's time and an eighth of zstd's, for 1.6 and 3
times the bytes. In the frames that
`stone.scoring.columns` counts, the deflated plane of late voxels follows; `late` (n,) is its length in bytes. Equal
ground truths give equal bytes. The platform writes every pack, so its checks only detect damage.
"""

import json
import os
import struct
import zlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import Any, Self
from zipfile import BadZipFile

import deflate
import numpy as np
from numpy.typing import NDArray

from stone.errors import Refused, StoneError
from stone.scoring.bitplanes import frame_counts, truth_of_planes
from stone.scoring.frame_counts import TruthPlanes, counted_every
from stone.scoring.metric import CLASSES
from stone.scoring.plane_layout import RINGS, layout_of
from stone.scoring.plane_runs import PLANES, PlaneRuns, planes_of, runs_of
from stone.scoring.truth_hash import truth_hash, whole_hash
from stone_base.label_grid import PAPER, LabelGrid, grid_of
from stone_files.atomic import atomic_file
from stone_files.npz import npz_bytes
from stone_submissions.errors import UnreadableInputError
from stone_submissions.ground_truth import LATE
from stone_submissions.manifest import Manifest
from stone_submissions.validation import THREADS, Progress, silent

MAGIC = b"STONEGT1"
TRAILER = struct.Struct("<Q8s")
BATCH = 32  # frames in memory at a time
SUPPORTS = 3 * CLASSES + 1
NOT_KEPT = -1


class TruthPackError(StoneError):
    """A stored ground truth differs from what was written."""

    code = "bad_truth_pack"

    def __init__(self, path: Path, fault: str) -> None:
        super().__init__(f"ground truth {path.name}: {fault}; was the file damaged, or written by another version?")


@dataclass(frozen=True)
class PackSummary:
    """`sha256` covers everything evaluated, as in the signature of a score; it is not the file's hash."""

    sha256: str
    frames: int


@dataclass(frozen=True, eq=False)
class _PackedTruthFrame:
    payload: bytes
    late_bytes: int
    counts: NDArray[np.int64]
    other_supports: NDArray[np.int32]
    hash: bytes


def write_truth_pack(
    path: Path,
    manifest: Manifest,
    truth_of: Callable[[str], TruthPlanes],
    *,
    threads: int = THREADS,
    progress: Progress = silent,
) -> PackSummary:
    """Write the ground truth of every frame of the manifest, atomically and with constant memory.

    `truth_of` is called from several threads; its errors are raised.
    """
    tokens, index = manifest.tokens, _Index(manifest.grid)
    counted = frozenset(tokens[:: counted_every(len(tokens))])

    def packed_of(token: str) -> _PackedTruthFrame:
        truth = truth_of(token)
        return _packed(truth if token in counted else replace(truth, late=None))

    with atomic_file(path) as staging, staging.open("wb") as file, ThreadPoolExecutor(threads) as pool:
        file.write(MAGIC)
        for start in range(0, len(tokens), BATCH):
            batch = tokens[start : start + BATCH]
            for token, packed in zip(batch, pool.map(packed_of, batch), strict=True):
                file.write(packed.payload)
                index.add(token, packed)
            progress("truth", start + len(batch), len(tokens))
        file.write(index.npz() + TRAILER.pack(index.offsets[-1], MAGIC))
    return PackSummary(whole_hash(index.hashes), len(tokens))


class TruthPack:
    """An open pack: any thread may read any frame, and holds one at a time.

    Raises `UnreadableInputError` if the file cannot be opened and `TruthPackError` if it is not a pack.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._descriptor = os.open(path, os.O_RDONLY)
        except OSError as error:
            raise UnreadableInputError(path, error.strerror or "unknown reason") from error
        try:
            index = self._read_index()
        except BaseException:
            self.close()
            raise
        self.tokens: tuple[str, ...] = tuple(token.tobytes().hex() for token in index["tokens"])
        self._offsets, self._counts, self._crc32 = (index[key] for key in ("offsets", "counts", "crc32"))
        self._other_supports = index.get("other_supports")
        self._late_bytes = index.get(LATE, np.zeros(len(self.tokens), np.uint32)).tolist()
        self.grid = self._grid_in(index)
        self._changes = PLANES * layout_of(self.grid).columns // 64

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def close(self) -> None:
        os.close(self._descriptor)

    def planes(self, index: int) -> TruthPlanes:
        """Return the ground truth of frame `index`. Raises `TruthPackError` if its bytes changed."""
        start, stop = self._offsets[index : index + 2].tolist()
        packed = os.pread(self._descriptor, stop - start, start)
        if deflate.crc32(packed) != self._crc32[index]:
            raise TruthPackError(self._path, f"frame {index} fails its checksum")
        changes = np.frombuffer(packed, np.uint64, self._changes)
        end = len(packed) - self._late_bytes[index]
        runs = PlaneRuns(changes, np.frombuffer(packed[changes.nbytes : end], np.uint32))
        late = np.frombuffer(zlib.decompress(packed[end:]), np.uint64) if end < len(packed) else None
        return TruthPlanes(planes_of(runs), self._counts[index], self.grid, late)

    def planes_of(self, token: str) -> TruthPlanes:
        """Return the ground truth of this frame, which must be in `tokens`."""
        return self.planes(self._index_of[token])

    def supports(self) -> NDArray[np.int32]:
        """Return the counts of the ground truth alone, (F, ring, 13).

        They are voxels by class, drivable columns, columns by class, late voxels by class. A pack of an earlier version
        has only voxels by class; other counts are `NOT_KEPT`.
        """
        evaluated, low, high, both = np.moveaxis(self._counts, -1, 0)
        voxels = np.stack([evaluated - low - high + both, low - both, high - both, both], axis=-1)
        unknown = np.full((*voxels.shape[:-1], SUPPORTS - CLASSES), NOT_KEPT)
        return np.concatenate(
            [voxels, unknown if self._other_supports is None else self._other_supports], axis=-1
        ).astype(np.int32)

    @cached_property
    def _index_of(self) -> dict[str, int]:
        return {token: index for index, token in enumerate(self.tokens)}

    def _read_index(self) -> dict[str, NDArray[Any]]:
        size_bytes = os.fstat(self._descriptor).st_size
        trailer = os.pread(self._descriptor, TRAILER.size, max(size_bytes - TRAILER.size, 0))
        if len(trailer) < TRAILER.size or trailer[8:] != MAGIC:
            raise TruthPackError(self._path, "its end is not that of a pack")
        start, stop = TRAILER.unpack(trailer)[0], size_bytes - TRAILER.size
        if not len(MAGIC) <= start <= stop:
            raise TruthPackError(self._path, f"its index should start at byte {start} of {stop}")
        raw = os.pread(self._descriptor, stop - start, start)
        try:
            with np.load(BytesIO(raw), allow_pickle=False) as arrays:
                keys = ("tokens", "offsets", "counts", "crc32", *arrays.keys() & {"other_supports", "grid", LATE})
                return {key: arrays[key] for key in keys}
        except (ValueError, OSError, KeyError, EOFError, BadZipFile) as error:
            raise TruthPackError(self._path, "its index is not an npz file") from error

    def _grid_in(self, index: dict[str, NDArray[Any]]) -> LabelGrid:
        if "grid" not in index:
            return PAPER
        try:
            return grid_of(json.loads(index["grid"].tobytes()))
        except (ValueError, Refused) as error:
            raise TruthPackError(self._path, "its grid is invalid") from error


class _Index:
    """The index of the frames written so far."""

    def __init__(self, grid: LabelGrid) -> None:
        self._grid = grid
        self.hashes: dict[str, bytes] = {}
        self.offsets = [len(MAGIC)]
        self._counts: list[NDArray[np.int64]] = []
        self._late_bytes: list[int] = []
        self._crc32: list[int] = []
        self._other_supports: list[NDArray[np.int32]] = []

    def add(self, token: str, packed: _PackedTruthFrame) -> None:
        self.hashes[token] = packed.hash
        self.offsets.append(self.offsets[-1] + len(packed.payload))
        self._counts.append(packed.counts)
        self._late_bytes.append(packed.late_bytes)
        self._crc32.append(deflate.crc32(packed.payload))
        self._other_supports.append(packed.other_supports)

    def npz(self) -> bytes:
        tokens = np.frombuffer(bytes.fromhex("".join(self.hashes)), np.uint8).reshape(-1, 16)
        counts = np.array(self._counts, np.int64).reshape(-1, RINGS, 4)
        offsets, crc32 = np.array(self.offsets, np.uint64), np.array(self._crc32, np.uint32)
        arrays: dict[str, NDArray[Any]] = {"tokens": tokens, "offsets": offsets, "counts": counts, "crc32": crc32}
        arrays["other_supports"] = np.array(self._other_supports, np.int32).reshape(-1, RINGS, SUPPORTS - CLASSES)
        if self._grid != PAPER:
            arrays["grid"] = np.frombuffer(json.dumps(self._grid.as_record()).encode(), np.uint8)
        if any(self._late_bytes):
            arrays[LATE] = np.array(self._late_bytes, np.uint32)
        return npz_bytes(arrays)


def _packed(truth: TruthPlanes) -> _PackedTruthFrame:
    runs = runs_of(truth.planes)
    late = b"" if truth.late is None else zlib.compress(truth.late.tobytes())
    payload = runs.changes.tobytes() + runs.columns.tobytes() + late
    return _PackedTruthFrame(payload, len(late), truth.counts, _other_supports(truth), truth_hash(truth))


def _other_supports(truth: TruthPlanes) -> NDArray[np.int32]:
    """Return the drivable columns, columns by class and late voxels by class of one frame, (ring, 9).

    These are the counts of a prediction that is free everywhere.
    """
    prediction = np.zeros(truth.grid.shape, np.uint8)
    free = frame_counts(prediction, truth)
    late = np.zeros((RINGS, CLASSES), np.int32)
    if truth.late is not None:
        late = frame_counts(prediction, truth_of_planes(truth.planes & truth.late, truth.grid)).confusion[:, :, 0]
    return np.concatenate([free.bev[:, 1:2], free.column_counts.columns[:, :, 0], late], axis=1)
