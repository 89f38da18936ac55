"""Packs: many small files concatenated into few blobs, with an index.

**Conventions.** Files stand in the order of their names, and so they do in an archive; the last is `sha256sum.txt`,
which checks all others (`sha256sum -c`). A pack is closed once it has `PACK_BYTES`. Equal folders give equal packs.
"""

import io
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.runtime.store.folder import refusing_full
from stone_files.npz import npz_bytes
from stone_files.virtual_archive import ArchiveMembers, check_names

SUMS = "sha256sum.txt"
PACK_BYTES = 2**30
PIECE_BYTES = 2**20
COLUMNS = ("sizes_bytes", "crc32", "sha256", "packs", "offsets_bytes")
Step = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class PackedFiles:
    """N files: names, sizes, CRC-32 and sha256 (N, 32) of their contents, and where each begins in which pack."""

    names: tuple[str, ...]
    sizes_bytes: NDArray[np.int64]
    crc32: NDArray[np.uint32]
    sha256: NDArray[np.uint8]
    packs: NDArray[np.int32]
    offsets_bytes: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.names)

    @property
    def members(self) -> ArchiveMembers:
        return ArchiveMembers(self.names, self.sizes_bytes, self.crc32)

    @cached_property
    def ordinals(self) -> Mapping[str, int]:
        """The place of each file by its name."""
        return {name: ordinal for ordinal, name in enumerate(self.names)}

    def digest(self, ordinal: int) -> str:
        """The sha256 of a file's content, in hex."""
        return bytes(self.sha256[ordinal]).hex()


@dataclass(frozen=True)
class _PackedFile:
    """A file that was written into a pack."""

    name: str
    size_bytes: int
    crc32: int
    sha256: bytes
    pack: int
    offset_bytes: int


def pack_path(packs: Path, number: int) -> Path:
    return packs / f"{number:06d}.pack"


def pack_folder(folder: Path, packs: Path, step: Step, pack_bytes: int = PACK_BYTES) -> PackedFiles:
    """Move every file of `folder` into packs of the empty folder `packs`; each is gone once it is in its pack.

    Raises `BadMemberError`, before anything is moved, and `StoreFullError`.
    """
    names = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    check_names([*names, SUMS])
    packs.mkdir(parents=True, exist_ok=True)
    packed = list[_PackedFile]()
    with refusing_full(packs):
        for done, name in enumerate(names):
            step(done, len(names))
            packed.append(_packed(folder, name, packs, _next_place(packed, pack_bytes)))
            (folder / name).unlink()
        (folder / SUMS).write_text("".join(f"{file.sha256.hex()}  {file.name}\n" for file in packed))
        packed.append(_packed(folder, SUMS, packs, _next_place(packed, pack_bytes)))
    step(len(names), len(names))
    return _columns(packed)


def index_bytes(files: PackedFiles) -> bytes:
    """The index as a file; the same bytes for equal files."""
    arrays: dict[str, NDArray[Any]] = {name: getattr(files, name) for name in COLUMNS}
    return npz_bytes({"names": np.frombuffer("\n".join(files.names).encode("ascii"), np.uint8), **arrays})


def read_index(payload: bytes) -> PackedFiles:
    """The files whose index `index_bytes` wrote; it comes from our own store."""
    with np.load(io.BytesIO(payload), allow_pickle=False) as arrays:
        names = arrays["names"].tobytes().decode("ascii").split("\n")
        return PackedFiles(tuple(names), **{name: arrays[name] for name in COLUMNS})


def pack_count(files: PackedFiles) -> int:
    return int(files.packs.max()) + 1 if len(files) else 0


def _next_place(packed: list[_PackedFile], pack_bytes: int) -> tuple[int, int]:
    """The pack and the offset at which the next file is written."""
    if not packed:
        return 0, 0
    end = packed[-1].offset_bytes + packed[-1].size_bytes
    return (packed[-1].pack, end) if end < pack_bytes else (packed[-1].pack + 1, 0)


def _packed(folder: Path, name: str, packs: Path, place: tuple[int, int]) -> _PackedFile:
    number, offset = place
    digest, crc, size = sha256(), 0, 0
    with pack_path(packs, number).open("ab" if offset else "wb") as pack:
        for piece in pieces_of(folder / name):
            pack.write(piece)
            digest.update(piece)
            crc, size = zlib.crc32(piece, crc), size + len(piece)
    return _PackedFile(name, size, crc, digest.digest(), number, offset)


def pieces_of(path: Path, start: int = 0, stop: int | None = None) -> Iterator[bytes]:
    """The bytes [start, stop) of a file, in pieces."""
    with path.open("rb") as file:
        file.seek(start)
        while piece := file.read(PIECE_BYTES if stop is None else min(PIECE_BYTES, stop - file.tell())):
            yield piece


def _columns(packed: list[_PackedFile]) -> PackedFiles:
    return PackedFiles(
        tuple(file.name for file in packed),
        np.array([file.size_bytes for file in packed], np.int64),
        np.array([file.crc32 for file in packed], np.uint32),
        np.frombuffer(b"".join(file.sha256 for file in packed), np.uint8).reshape(-1, 32),
        np.array([file.pack for file in packed], np.int32),
        np.array([file.offset_bytes for file in packed], np.int64),
    )
