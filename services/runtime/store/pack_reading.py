"""Reads packed files: one of them, or any range of an archive of all, with constant memory.

**Conventions.** Files stand in packs in the order of an archive, so a range of an archive is read by few streams, not
by one request for each of thousands of files. Small segments are gathered: a piece is about `PIECE_BYTES`.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from services.runtime.store.packs import PackedFiles, Step, pack_path, pieces_of
from services.runtime.store.protocol import Store
from stone.errors import PlatformFaultError
from stone_files.virtual_archive import Archive, ArchiveMemberRange, Kind, layout

PIECE_BYTES = 2**18
ReadPack = Callable[[int, int, int], Iterator[bytes]]


class ShortPackError(PlatformFaultError):
    """A pack ends before its index says."""

    code = "short_pack"

    def __init__(self, number: int, place: int) -> None:
        super().__init__(f"pack {number} ends at byte {place}, before its index says; was the store changed by hand?")


@dataclass(frozen=True, eq=False)
class StoredFiles:
    """Files in packs that are these objects of the store."""

    files: PackedFiles
    object_keys: tuple[str, ...]

    def reader(self, store: Store) -> ReadPack:
        return lambda number, start, stop: store.read(self.object_keys[number], start, stop)


def file_pieces(files: PackedFiles, ordinal: int, span: tuple[int, int], read: ReadPack) -> Iterator[bytes]:
    """The bytes [start, stop) of one file, in pieces."""
    yield from map(bytes, _Stream(files, read, span[1] - span[0]).take(ArchiveMemberRange(ordinal, *span)))


def archive_pieces(files: PackedFiles, archive: Archive, span: tuple[int, int], read: ReadPack) -> Iterator[bytes]:
    """The bytes [start, stop) of an archive of the files, in pieces."""
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
    """Reads packs that lie in a folder."""
    return lambda number, start, stop: pieces_of(pack_path(packs, number), start, stop)


def archive_sha256(files: PackedFiles, kind: Kind, read: ReadPack, step: Step) -> tuple[int, str]:
    """The size and the sha256 of the whole archive, which is read once; steps are in MiB."""
    archive = layout(files.members, kind)
    total, digest, done = archive.size_bytes, sha256(), 0
    for piece in archive_pieces(files, archive, (0, total), read):
        digest.update(piece)
        done += len(piece)
        step(done >> 20, total >> 20)
    return total, digest.hexdigest()


class _Stream:
    """Contents one after another: what follows on in the same pack is read on from the same stream.

    `most_bytes` is how much anybody will ask for: no stream is opened for more.
    """

    def __init__(self, files: PackedFiles, read: ReadPack, most_bytes: int) -> None:
        self._files, self._read, self._most_bytes = files, read, most_bytes
        self._at = (-1, 0)
        self._pieces: Iterator[bytes] = iter(())
        self._rest = memoryview(b"")

    def take(self, content: ArchiveMemberRange) -> Iterator[memoryview]:
        """The content in pieces. Raises `ShortPackError`."""
        number = int(self._files.packs[content.ordinal])
        place = int(self._files.offsets_bytes[content.ordinal]) + content.start
        if len(content) and (number, place) != self._at:
            self._pieces, self._rest = self._read(number, place, place + self._most_bytes), memoryview(b"")
        left = len(content)
        while left:
            self._rest = self._rest or memoryview(next(self._pieces, b""))
            if not self._rest:
                raise ShortPackError(number, place)
            part, self._rest = self._rest[:left], self._rest[left:]
            left, place, self._at = left - len(part), place + len(part), (number, place + len(part))
            yield part
