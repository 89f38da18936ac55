"""The pages of a SQLite file, read without SQLite: to check a hostile file before SQLite opens it, and to salvage a
malformed one.

**Conventions.** Page numbers start at 1. Nothing is trusted: a page out of range is None, and a cell that overruns its
page is left out. A chain of overflow pages ends after as many as its payload needs. A write-ahead log beside the file
replaces pages up to its last commit; its checksums are not recomputed. Source: sqlite.org/fileformat2.html.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from struct import Struct

from stone_recordings.bags.errors import database_refused

MAGIC = b"SQLite format 3\x00"
HEADER_BYTES = 100
LEAF, INTERIOR = 0x0D, 0x05
WAL_HEADER_BYTES, WAL_FRAME_BYTES = 32, 24
WAL_MAGICS = (0x377F0682, 0x377F0683)
ENCODINGS = {1: "utf-8", 2: "utf-16-le", 3: "utf-16-be"}
_U16, _U32, _WAL_FRAME = Struct(">H"), Struct(">I"), Struct(">IIII")


@dataclass(frozen=True, slots=True)
class Cell:
    """One row in its leaf: `local` is the part of its `payload_bytes` that the leaf holds."""

    rowid: int
    payload_bytes: int
    local: memoryview
    overflow_page: int


class Db3Pages:
    """The pages of `main`, replaced by those of `wal`; b"" without a log."""

    def __init__(self, main: memoryview, wal: memoryview, name: str) -> None:
        self._main, self._wal = main, wal
        header = bytes(main[:HEADER_BYTES]) or _wal_first_page(wal)
        if len(header) < HEADER_BYTES or not header.startswith(MAGIC):
            raise database_refused(name, "its first page is not an SQLite header")
        self.page_bytes = 65536 if header[16:18] == b"\x00\x01" else int(_U16.unpack_from(header, 16)[0])
        self.usable_bytes = self.page_bytes - header[20]
        if self.page_bytes < 512 or self.page_bytes & (self.page_bytes - 1) or self.usable_bytes < 480:
            raise database_refused(name, f"its page size is {self.page_bytes} with {header[20]} bytes reserved")
        self.encoding = ENCODINGS.get(int(_U32.unpack_from(header, 56)[0]), "utf-8")
        self._logged = dict(_logged_pages(wal, self.page_bytes))
        self.count = max(len(main) // self.page_bytes, max(self._logged, default=0))

    def page(self, number: int) -> memoryview | None:
        """Return the bytes of a page; None beyond the file."""
        if number in self._logged:
            return self._wal[self._logged[number] : self._logged[number] + self.page_bytes]
        start = (number - 1) * self.page_bytes
        whole = self._main[start : start + self.page_bytes] if number > 0 else self._main[:0]
        return whole if len(whole) == self.page_bytes else None

    def kind(self, number: int) -> int:
        """Return the b-tree flag of a page; 0 if there is no such page."""
        page = self.page(number)
        return 0 if page is None else page[_header_at(number)]

    def children(self, number: int) -> Iterator[int]:
        """Yield the page numbers under an interior page of a table, in order of their keys."""
        page = self.page(number)
        if page is None:
            return
        for at in _cell_offsets(page, _header_at(number), 12):
            if at + 4 <= self.usable_bytes:
                yield int(_U32.unpack_from(page, at)[0])
        yield int(_U32.unpack_from(page, _header_at(number) + 8)[0])

    def cells(self, number: int) -> Iterator[Cell]:
        """Yield the rows of a leaf page of a table that lie inside it."""
        page = self.page(number)
        if page is None:
            return
        for at in _cell_offsets(page, _header_at(number), 8):
            if (cell := self._cell(page, at)) is not None:
                yield cell

    def overflow(self, cell: Cell, size_bytes: int, used: bytearray | None = None) -> list[int] | None:
        """Return the pages that hold the first `size_bytes` of a row beyond its leaf; None if their chain is broken.

        `used` (a byte a page) is marked; a page that another row marked breaks the chain. So no file can make the walk
        over all its rows longer than the file.
        """
        numbers: list[int] = []
        left, number = min(size_bytes, cell.payload_bytes) - len(cell.local), cell.overflow_page
        while left > 0:
            page = self.page(number)
            if page is None or (used is not None and used[number]):
                return None
            if used is not None:
                used[number] = 1
            numbers.append(number)
            left -= self.usable_bytes - 4
            number = int(_U32.unpack_from(page)[0])
        return numbers

    def payload(self, cell: Cell, size_bytes: int | None = None) -> bytes | None:
        """Return the first `size_bytes` of a row (default: all); None if its chain of pages is broken."""
        wanted = cell.payload_bytes if size_bytes is None else min(size_bytes, cell.payload_bytes)
        if wanted > self.count * self.page_bytes or (numbers := self.overflow(cell, wanted)) is None:
            return None
        pages = (self.page(number) for number in numbers)
        parts = [bytes(page[4 : self.usable_bytes]) for page in pages if page is not None]
        return b"".join([bytes(cell.local), *parts])[:wanted]

    def _cell(self, page: memoryview, at: int) -> Cell | None:
        payload_bytes, at = read_varint(page, at)
        rowid, at = read_varint(page, at)
        local_bytes = self._local_bytes(payload_bytes)
        stop = at + local_bytes + (4 if local_bytes < payload_bytes else 0)
        if stop > self.usable_bytes:
            return None
        overflow = int(_U32.unpack_from(page, stop - 4)[0]) if local_bytes < payload_bytes else 0
        return Cell(signed(rowid), payload_bytes, page[at : at + local_bytes], overflow)

    def _local_bytes(self, payload_bytes: int) -> int:
        """Return how much of a payload its leaf holds (file format, section 1.6)."""
        most = self.usable_bytes - 35
        if payload_bytes <= most:
            return payload_bytes
        least = (self.usable_bytes - 12) * 32 // 255 - 23
        local = least + (payload_bytes - least) % (self.usable_bytes - 4)
        return local if local <= most else least


def read_varint(view: memoryview | bytes, at: int) -> tuple[int, int]:
    """Return a big-endian base-128 number of at most nine bytes, and its end; past the end of the view it is 0."""
    value = 0
    for count in range(9):
        if at >= len(view):
            return 0, at + 1
        byte = view[at]
        at += 1
        if count == 8:
            return value << 8 | byte, at
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, at
    return value, at


def signed(value: int) -> int:
    """Return a 64-bit pattern as a two's complement number."""
    return value - (1 << 64) if value >= 1 << 63 else value


def _header_at(number: int) -> int:
    return HEADER_BYTES if number == 1 else 0


def _cell_offsets(page: memoryview, header_at: int, header_bytes: int) -> Iterator[int]:
    count = int(_U16.unpack_from(page, header_at + 3)[0])
    first = header_at + header_bytes
    for offset in range(first, min(first + 2 * count, len(page) - 1), 2):
        yield int(_U16.unpack_from(page, offset)[0])


def _wal_first_page(wal: memoryview) -> bytes:
    start = WAL_HEADER_BYTES + WAL_FRAME_BYTES
    return bytes(wal[start : start + HEADER_BYTES])


def _logged_pages(wal: memoryview, page_bytes: int) -> Iterator[tuple[int, int]]:
    """Yield page number and offset of every frame up to the last commit; later ones replace earlier ones."""
    if len(wal) < WAL_HEADER_BYTES or _U32.unpack_from(wal)[0] not in WAL_MAGICS:
        return
    salts = bytes(wal[16:24])
    pending: list[tuple[int, int]] = []
    for at in range(WAL_HEADER_BYTES, len(wal) - WAL_FRAME_BYTES - page_bytes + 1, WAL_FRAME_BYTES + page_bytes):
        number, commit, *_salts = _WAL_FRAME.unpack_from(wal, at)
        if bytes(wal[at + 8 : at + 16]) != salts:
            return
        pending.append((int(number), at + WAL_FRAME_BYTES))
        if commit:
            yield from pending
            pending.clear()
