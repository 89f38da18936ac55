"""Virtual tar and zip archives: the offset of every byte, computed from names, sizes and CRCs.

**Conventions.** Pure layout, no bytes of content: an archive is a row of regions, each some header bytes and perhaps
the content of one member, so any range can be served by itself. Equal members give equal bytes: every file is 0644, of
nobody, of 1980-01-01 (the first day a zip knows; tar warns of 1970). A member's name is a relative path of plain ASCII
parts, so that nothing can be unpacked outside of its folder, on any system.

Source: POSIX.1-2017 pax §"ustar Interchange Format" and §"pax Interchange Format"; PKWARE APPNOTE 6.3.10 §4.3, §4.5.3.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from stone_base.errors import StoneError
from stone_files.tar_headers import END_BYTES, RECORD_BYTES, padding_bytes, tar_head, tar_head_bytes
from stone_files.zip_headers import ZipEntry, central_bytes, end_bytes, local_bytes, zip_central, zip_end, zip_local

Kind = Literal["tar", "zip"]
KINDS: tuple[Kind, ...] = ("tar", "zip")
MEDIA_TYPES = {"tar": "application/x-tar", "zip": "application/zip"}
MOST_NAME = 512
_PART = r"[A-Za-z0-9_+=@-][A-Za-z0-9._+=@-]*"
NAME = re.compile(rf"{_PART}(/{_PART})*")


class BadMemberError(StoneError):
    """A file cannot have this name in an archive."""

    code = "bad_member"

    def __init__(self, name: str, why: str) -> None:
        super().__init__(f"{name[:200]!r} cannot be a file of an archive: {why}")


@dataclass(frozen=True)
class ArchiveMemberRange:
    """The bytes [start, stop) of the content of the member at this place."""

    ordinal: int
    start: int
    stop: int

    def __len__(self) -> int:
        return self.stop - self.start

    def __getitem__(self, part: slice) -> "ArchiveMemberRange":
        return ArchiveMemberRange(self.ordinal, self.start + part.start, self.start + part.stop)


Segment = bytes | ArchiveMemberRange


@dataclass(frozen=True, eq=False)
class ArchiveMembers:
    """What stands in an archive, in order: N names, sizes (N,) int64 and CRC-32 of contents (N,) uint32."""

    names: Sequence[str]
    sizes_bytes: NDArray[np.int64]
    crc32: NDArray[np.uint32]

    def entry(self, ordinal: int, offset: int = 0) -> ZipEntry:
        return ZipEntry(self.names[ordinal], int(self.sizes_bytes[ordinal]), int(self.crc32[ordinal]), offset)


@dataclass(frozen=True, eq=False)
class Archive:
    """`starts` (R + 1,): where each region begins, and the end; `region` gives the segments of one."""

    starts: NDArray[np.int64]
    region: Callable[[int], Iterable[Segment]]

    @property
    def size_bytes(self) -> int:
        return int(self.starts[-1])

    def segments(self, start: int, stop: int) -> Iterator[Segment]:
        """What the bytes [start, stop) consist of, clipped to the archive; none is empty."""
        first = int(np.searchsorted(self.starts, start, "right")) - 1
        place, number = int(self.starts[first]), first
        while place < min(stop, self.size_bytes):
            for segment in self.region(number):
                low, high = max(start - place, 0), min(stop - place, len(segment))
                if low < high:
                    yield segment[low:high]
                place += len(segment)
            number += 1


def layout(members: ArchiveMembers, kind: Kind) -> Archive:
    """The archive of these members, whose names `check_names` has let pass."""
    return _tar(members) if kind == "tar" else _zip(members)


def check_names(names: Iterable[str]) -> None:
    """Raises `BadMemberError` for a name that is no plain path, stands twice or is both a file and a folder.

    Names are compared as on a disk that does not tell cases apart.
    """
    files, folders = set[str](), set[str]()
    for name in names:
        if len(name) > MOST_NAME or not NAME.fullmatch(name):
            raise BadMemberError(name, f"it is not a relative path of letters, digits and ._+=@- below {MOST_NAME}")
        folded = name.casefold()
        if folded in files:
            raise BadMemberError(name, "there is another file of that name")
        files.add(folded)
        folders |= {folded[:place] for place, sign in enumerate(folded) if sign == "/"}
    for both in sorted(files & folders):
        raise BadMemberError(both, "a folder has the same name")


def _tar(members: ArchiveMembers) -> Archive:
    """Heads, contents padded to blocks, and zeros that fill the last record."""
    sizes = members.sizes_bytes
    heads = np.fromiter(map(tar_head_bytes, members.names, sizes.tolist()), np.int64, len(sizes))
    starts = _starts(heads + sizes + padding_bytes(sizes))
    end = int(starts[-1]) + END_BYTES
    total = end + -end % RECORD_BYTES

    def region(number: int) -> Iterable[Segment]:
        if number == len(sizes):
            return (bytes(total - int(starts[-1])),)
        size = int(sizes[number])
        padding = bytes(int(padding_bytes(sizes[number])))
        return (tar_head(members.names[number], size), ArchiveMemberRange(number, 0, size), padding)

    return Archive(np.append(starts, total), region)


def _zip(members: ArchiveMembers) -> Archive:
    """Local headers with stored contents, the central directory entry by entry, the end."""
    sizes, count = members.sizes_bytes, len(members.sizes_bytes)
    names = np.fromiter(map(len, members.names), np.int64, count)
    offsets = _starts(local_bytes(names, sizes) + sizes)
    central = offsets[-1] + _starts(central_bytes(names, sizes, offsets[:-1]))
    begin, length = int(central[0]), int(central[-1] - central[0])
    total = int(central[-1]) + end_bytes(count, begin, length)

    def region(number: int) -> Iterable[Segment]:
        if number == 2 * count:
            return (zip_end(count, begin, length),)
        entry = members.entry(number % count, int(offsets[number % count]))
        return (
            (zip_central(entry),)
            if number >= count
            else (zip_local(entry), ArchiveMemberRange(number, 0, entry.size_bytes))
        )

    return Archive(np.concatenate([offsets[:-1], central, [total]]), region)


def _starts(lengths: NDArray[np.int64]) -> NDArray[np.int64]:
    """Where each begins that follow one another from 0, and where the last ends."""
    return np.concatenate([np.zeros(1, np.int64), np.cumsum(lengths, dtype=np.int64)])
