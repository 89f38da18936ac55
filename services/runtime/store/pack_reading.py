"""Read packed files: one file, or any range of an archive of all files, with constant memory.

**Conventions.** Packs contain files in the order of an archive, so a range of an archive needs few streams instead of
thousands of requests. Small segments are gathered: a piece is about `PIECE_BYTES`.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from pathlib import Path

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.orm import Blob, Export, ExportPack
from services.runtime.store.packs import PackedFiles, Step, pack_path, pieces_of, read_index, short_pack
from services.runtime.store.protocol import Store
from stone.errors import Refused
from stone_files.archives import Archive, ArchiveMemberRange, Kind, layout

PIECE_BYTES = 2**18
ReadPack = Callable[[int, int, int], Iterator[bytes]]


@dataclass(frozen=True, eq=False)
class StoredFiles:
    """Packed files with the objects of the store that contain them."""

    files: PackedFiles
    object_keys: tuple[str, ...]

    def reader(self, store: Store) -> ReadPack:
        return lambda number, start, stop: store.read(self.object_keys[number], start, stop)


def file_pieces(files: PackedFiles, ordinal: int, span: tuple[int, int], read: ReadPack) -> Iterator[bytes]:
    """Yield the bytes [start, stop) of one file, in pieces."""
    yield from map(bytes, _Stream(files, read, span[1] - span[0]).take(ArchiveMemberRange(ordinal, *span)))


def archive_pieces(files: PackedFiles, archive: Archive, span: tuple[int, int], read: ReadPack) -> Iterator[bytes]:
    """Yield the bytes [start, stop) of an archive of the files, in pieces."""
    stream, held = _Stream(files, read, span[1] - span[0]), bytearray()
    for segment in archive.segments(*span):
        for piece in stream.take(segment) if isinstance(segment, ArchiveMemberRange) else (segment,):
            held += piece
            if len(held) >= PIECE_BYTES:
                yield bytes(held)
                held.clear()
    if held:
        yield bytes(held)


def local_reader(packs: Path) -> ReadPack:
    """Return a reader of packs in a folder."""
    return lambda number, start, stop: pieces_of(pack_path(packs, number), start, stop)


def archive_sha256(files: PackedFiles, kind: Kind, read: ReadPack, step: Step) -> tuple[int, str]:
    """Return the size and the sha256 of the whole archive, reading it once; steps are in MiB."""
    archive = layout(files.members, kind)
    total, digest, done = archive.size_bytes, sha256(), 0
    for piece in archive_pieces(files, archive, (0, total), read):
        digest.update(piece)
        done += len(piece)
        step(done >> 20, total >> 20)
    return total, digest.hexdigest()


class _Stream:
    """Contents one after another; adjacent contents of one pack share a stream.

    `most_bytes` is an upper limit of the bytes to read, and of each stream.
    """

    def __init__(self, files: PackedFiles, read: ReadPack, most_bytes: int) -> None:
        self._files, self._read, self._most_bytes = files, read, most_bytes
        self._at = (-1, 0)
        self._pieces: Iterator[bytes] = iter(())
        self._rest = memoryview(b"")

    def take(self, content: ArchiveMemberRange) -> Iterator[memoryview]:
        """Yield the content in pieces. Raises `short_pack`."""
        number = int(self._files.packs[content.ordinal])
        offset = int(self._files.offsets_bytes[content.ordinal]) + content.start
        if len(content) and (number, offset) != self._at:
            self._pieces, self._rest = self._read(number, offset, offset + self._most_bytes), memoryview(b"")
        left = len(content)
        while left:
            self._rest = self._rest or memoryview(next(self._pieces, b""))
            if not self._rest:
                raise short_pack(number, offset)
            part, self._rest = self._rest[:left], self._rest[left:]
            left, offset, self._at = left - len(part), offset + len(part), (number, offset + len(part))
            yield part


# The files of a finished export, and the archives made of them.
#
# **Conventions.** A process caches the last few indexes and layouts: objects never change, so the cached values stay
# valid.


HELD = 4


@dataclass(frozen=True)
class ExportLocation:
    """The objects of the store that contain an export."""

    index_key: str
    pack_keys: tuple[str, ...]


def locate_export(session: Session, export: Export) -> ExportLocation:
    """Return the locations of an export's files. Raises `export_unfinished`."""
    if export.index_sha256 is None:
        raise Refused(
            "export_unfinished",
            f"export {export.id} has no files yet; job {export.job_id} writes them, try again when it has succeeded",
        )
    packs = select(Blob.object_key).join(ExportPack, ExportPack.blob_sha256 == Blob.sha256)
    of_export = packs.where(ExportPack.export_id == export.id).order_by(ExportPack.ordinal)
    index = session.get_one(Blob, export.index_sha256)
    return ExportLocation(index.object_key, tuple(session.scalars(of_export)))


def stored_files(store: Store, located: ExportLocation) -> StoredFiles:
    """Return the files of an export; it reads the index from the store, so call it outside transactions."""
    return StoredFiles(_read_index(store, located.index_key), located.pack_keys)


@lru_cache(maxsize=HELD)
def archive_of(files: PackedFiles, kind: Kind) -> Archive:
    """Return the archive of all the files; `files` are compared by identity."""
    return layout(files.members, kind)


@lru_cache(maxsize=HELD)
def _read_index(store: Store, object_key: str) -> PackedFiles:
    """Return the index, cached because objects never change."""
    return read_index(b"".join(store.read(object_key)))
