"""Packs: many small files concatenated into few blobs, with an index.

**Conventions.** Packs and archives contain files in the order of their names; the last is `sha256sum.txt`, which checks
all others (`sha256sum -c`). A pack is closed at `PACK_BYTES`. Equal folders give equal packs.
"""

import io
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from services.runtime.store.folder import refusing_full
from stone.errors import PlatformFaultError
from stone_files.archives import ArchiveMembers, check_names
from stone_files.npz import npz_bytes

SUMS = "sha256sum.txt"
PACK_BYTES = 2**30
PIECE_BYTES = 2**20
COLUMNS = ("sizes_bytes", "crc32", "sha256", "packs", "offsets_bytes")
Step = Callable[[int, int], None]
Bytes = bytes | memoryview


@dataclass(frozen=True, eq=False)
class PackedFiles:
    """N files: names, sizes, CRC-32 and sha256 (N, 32) of their contents, and the pack and offset of each."""

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
        """The index of each file by its name."""
        return {name: ordinal for ordinal, name in enumerate(self.names)}

    def digest(self, ordinal: int) -> str:
        """Return the sha256 of a file's content, in hex."""
        return bytes(self.sha256[ordinal]).hex()


@dataclass(frozen=True)
class _PackedFile:
    """A file in a pack."""

    name: str
    size_bytes: int
    crc32: int
    sha256: bytes
    pack: int
    offset_bytes: int


def pack_path(packs: Path, number: int) -> Path:
    return packs / f"{number:06d}.pack"


class PackWriter:
    """Write files into packs of the folder `packs`, one after another, in the order of their names."""

    def __init__(self, packs: Path, pack_bytes: int = PACK_BYTES) -> None:
        self._packs, self._pack_bytes, self._packed = packs, pack_bytes, list[_PackedFile]()
        packs.mkdir(parents=True, exist_ok=True)

    def add(self, name: str, pieces: Iterable[Bytes]) -> None:
        """Write a file from its bytes in pieces. Raises `StoreFullError`, and the errors of `pieces`."""
        number, offset = self._next_place()
        digest, crc, size = sha256(), 0, 0
        with refusing_full(self._packs), pack_path(self._packs, number).open("ab" if offset else "wb") as pack:
            for piece in pieces:
                pack.write(piece)
                digest.update(piece)
                crc, size = isal_zlib.crc32(piece, crc), size + len(piece)
        self._packed.append(_PackedFile(name, size, crc, digest.digest(), number, offset))

    def sums(self) -> bytes:
        """Return the content of `sha256sum.txt` for the written files."""
        return "".join(f"{file.sha256.hex()}  {file.name}\n" for file in self._packed).encode()

    def files(self) -> PackedFiles:
        """Return the written files."""
        return _columns(self._packed)

    def _next_place(self) -> tuple[int, int]:
        """Return the pack and the offset for the next file."""
        if not self._packed:
            return 0, 0
        last = self._packed[-1]
        end = last.offset_bytes + last.size_bytes
        return (last.pack, end) if end < self._pack_bytes else (last.pack + 1, 0)


def pack_folder(folder: Path, packs: Path, step: Step, pack_bytes: int = PACK_BYTES) -> PackedFiles:
    """Move every file of `folder` into packs of the empty folder `packs`; delete each file once it is in its pack.

    Raises `bad_member`, before moving anything, and `StoreFullError`.
    """
    names = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    check_names([*names, SUMS])
    packed = PackWriter(packs, pack_bytes)
    for done, name in enumerate(names):
        step(done, len(names))
        packed.add(name, pieces_of(folder / name))
        (folder / name).unlink()
    packed.add(SUMS, (packed.sums(),))
    step(len(names), len(names))
    return packed.files()


def index_bytes(files: PackedFiles) -> bytes:
    """Return the index as bytes, equal for equal files."""
    arrays: dict[str, NDArray[Any]] = {name: getattr(files, name) for name in COLUMNS}
    return npz_bytes({"names": np.frombuffer("\n".join(files.names).encode("ascii"), np.uint8), **arrays})


def read_index(payload: bytes) -> PackedFiles:
    """Return the files from the bytes of `index_bytes`; they come from our own store."""
    with np.load(io.BytesIO(payload), allow_pickle=False) as arrays:
        names = arrays["names"].tobytes().decode("ascii").split("\n")
        return PackedFiles(tuple(names), **{name: arrays[name] for name in COLUMNS})


def pack_count(files: PackedFiles) -> int:
    return int(files.packs.max()) + 1 if len(files) else 0


def pieces_of(path: Path, start: int = 0, stop: int | None = None) -> Iterator[bytes]:
    """Yield the bytes [start, stop) of a file, in pieces."""
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


def short_pack(number: int, place: int) -> PlatformFaultError:
    return PlatformFaultError(
        "short_pack",
        f"pack {number} ends at byte {place}, too early for its index; was the store changed by hand?",
    )
