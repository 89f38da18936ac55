"""Virtual tar and zip archives, and the index of a tar: the offset of every byte, from names, sizes and CRCs.

**Conventions.** Only the layout, without content. An archive is a sequence of regions, each with header bytes and
optionally the content of one member, so that any byte range can be served separately. Equal members give equal bytes:
every file is 0644, owner 0, dated 1980-01-01 (the first zip date; tar warns of 1970). A member's name is a relative
path of plain ASCII parts, so no system unpacks a file outside its folder.

Source: POSIX.1-2017 pax §"ustar Interchange Format" and §"pax Interchange Format"; PKWARE APPNOTE 6.3.10 §4.3, §4.5.3.
"""

import os
import re
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from stone_base.errors import Refused

# Tar headers: one ustar block per file, preceded by a pax record for long names and large sizes.


BLOCK_BYTES = 512
RECORD_BYTES = 20 * BLOCK_BYTES
END_BYTES = 2 * BLOCK_BYTES
MOST_USTAR_BYTES = 8**11 - 1
MODIFIED_S = 315_532_800  # 1980-01-01, as in a zip; tar warns of 1970
NAME_BYTES, PREFIX_BYTES = 100, 155
FORM = struct.Struct("<100s8s8s8s12s12s8sc100s6s2s32s32s8s8s155s12s")
CHECKSUM_AT = 148
Sizes = TypeVar("Sizes", np.int64, NDArray[np.int64])


def padding_bytes(sizes_bytes: Sizes) -> Sizes:
    """Return the number of padding zeros after contents of these sizes."""
    return -sizes_bytes % BLOCK_BYTES


def tar_head_bytes(name: str, size_bytes: int) -> int:
    """Return the length of `tar_head(name, size_bytes)`."""
    if size_bytes <= MOST_USTAR_BYTES and (len(name) <= NAME_BYTES or _split(name)):
        return BLOCK_BYTES
    record = len(_pax(name, size_bytes))
    return 2 * BLOCK_BYTES + record + -record % BLOCK_BYTES


def tar_head(name: str, size_bytes: int) -> bytes:
    """Return the header bytes of a file."""
    prefix_and_name = ("", name) if len(name) <= NAME_BYTES else _split(name)
    if prefix_and_name and size_bytes <= MOST_USTAR_BYTES:
        return _block(prefix_and_name, size_bytes, b"0")
    record = _pax(name, size_bytes)
    padded = record + bytes(-len(record) % BLOCK_BYTES)
    shown = ("", name[-NAME_BYTES:].lstrip("/"))
    ustar_bytes = size_bytes if size_bytes <= MOST_USTAR_BYTES else 0  # the record contains the size
    return _block(("", "PaxHeader"), len(record), b"x") + padded + _block(shown, ustar_bytes, b"0")


def _split(name: str) -> tuple[str, str] | None:
    """Return prefix and name, split at the last slash that leaves room for both; None if there is none."""
    at = name.rfind("/", 0, PREFIX_BYTES + 1)
    if at <= 0 or len(name) - at - 1 > NAME_BYTES:
        return None
    return name[:at], name[at + 1 :]


def _pax(name: str, size_bytes: int) -> bytes:
    r"""Return `path` and `size` as records `<length> <key>=<value>` with a newline; the length includes itself."""
    return _record("path", name) + _record("size", str(size_bytes))


def _record(key: str, value: str) -> bytes:
    rest = f" {key}={value}\n"
    length = len(rest)
    while len(str(length)) + len(rest) != length:
        length = len(str(length)) + len(rest)
    return f"{length}{rest}".encode("ascii")


def _block(prefix_and_name: tuple[str, str], size_bytes: int, kind: bytes) -> bytes:
    prefix, name = (part.encode("ascii") for part in prefix_and_name)
    numbers = (b"0000644\0", b"0000000\0", b"0000000\0", b"%011o\0" % size_bytes, b"%011o\0" % MODIFIED_S)
    owner = (b"ustar\0", b"00", b"", b"", b"0000000\0", b"0000000\0")
    block = FORM.pack(name, *numbers, b" " * 8, kind, b"", *owner, prefix, b"")
    return block[:CHECKSUM_AT] + b"%06o\0 " % sum(block) + block[CHECKSUM_AT + 8 :]


# Zip headers for stored entries. CRC and sizes are known in advance, so there are no data descriptors.


FULL32, FULL16 = 0xFFFFFFFF, 0xFFFF
STORED, DEFLATED = 0, 8
PLAIN, WITH_64 = 20, 45
UNIX, REGULAR_0644 = 3 << 8, 0o100644 << 16
DOS_1980_01_01 = 0x0021
LOCAL, CENTRAL = struct.Struct("<4s5H3I2H"), struct.Struct("<4s6H3I5H2I")
END, END_64, LOCATOR = struct.Struct("<4s4H2IH"), struct.Struct("<4sQ2H2I4Q"), struct.Struct("<4sIQI")


@dataclass(frozen=True)
class ZipEntry:
    """A stored file; its local header starts at `offset_bytes`."""

    name: str
    size_bytes: int
    crc32: int
    offset_bytes: int = 0


def local_bytes(names: NDArray[np.int64], sizes_bytes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the lengths of local headers for names of these lengths."""
    return np.asarray(LOCAL.size + names + 20 * (sizes_bytes >= FULL32), np.int64)


def central_bytes(
    names: NDArray[np.int64], sizes_bytes: NDArray[np.int64], offsets: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the lengths of central directory entries."""
    is_large, is_far = sizes_bytes >= FULL32, offsets >= FULL32
    return np.asarray(CENTRAL.size + names + 4 * (is_large | is_far) + 16 * is_large + 8 * is_far, np.int64)


def end_bytes(count: int, begin: int, length: int) -> int:
    """Return the length of `zip_end(count, begin, length)`."""
    return END.size + (END_64.size + LOCATOR.size if _needs_64(count, begin, length) else 0)


def zip_local(entry: ZipEntry) -> bytes:
    """Return the local header."""
    extra = _extra(entry.size_bytes, entry.size_bytes) if entry.size_bytes >= FULL32 else b""
    return LOCAL.pack(b"PK\3\4", *_described(entry, extra)) + entry.name.encode("ascii") + extra


def zip_central(entry: ZipEntry) -> bytes:
    """Return the central directory entry."""
    sizes = (entry.size_bytes, entry.size_bytes) if entry.size_bytes >= FULL32 else ()
    far = (entry.offset_bytes,) if entry.offset_bytes >= FULL32 else ()
    extra = _extra(*sizes, *far) if sizes or far else b""
    fields = (0, 0, 0, REGULAR_0644, min(entry.offset_bytes, FULL32))
    version = _version(extra)
    head = CENTRAL.pack(b"PK\1\2", UNIX | version, *_described(entry, extra), *fields)
    return head + entry.name.encode("ascii") + extra


def zip_end(count: int, begin: int, length: int) -> bytes:
    """Return the bytes after the central directory, which starts at `begin` and has `length` bytes."""
    plain = (min(count, FULL16), min(count, FULL16), min(length, FULL32), min(begin, FULL32))
    end = END.pack(b"PK\5\6", 0, 0, *plain, 0)
    if not _needs_64(count, begin, length):
        return end
    whole = END_64.pack(b"PK\6\6", END_64.size - 12, UNIX | WITH_64, WITH_64, 0, 0, count, count, length, begin)
    return whole + LOCATOR.pack(b"PK\6\7", 0, begin + length, 1) + end


def _described(entry: ZipEntry, extra: bytes) -> tuple[int, ...]:
    """Return the fields that the local header and the central entry share."""
    size = min(entry.size_bytes, FULL32)
    stamp = (0, DOS_1980_01_01)
    return (_version(extra), 0, 0, *stamp, entry.crc32, size, size, len(entry.name), len(extra))


def _extra(*values: int) -> bytes:
    return struct.pack(f"<2H{len(values)}Q", 1, 8 * len(values), *values)


def _version(extra: bytes) -> int:
    return WITH_64 if extra else PLAIN


def _needs_64(count: int, begin: int, length: int) -> bool:
    return count >= FULL16 or begin >= FULL32 or length >= FULL32


Kind = Literal["tar", "zip"]
KINDS: tuple[Kind, ...] = ("tar", "zip")
MEDIA_TYPES = {"tar": "application/x-tar", "zip": "application/zip"}
MOST_NAME = 512
_PART = r"[A-Za-z0-9_+=@-][A-Za-z0-9._+=@-]*"
NAME = re.compile(rf"{_PART}(/{_PART})*")


def bad_member(name: str, why: str) -> Refused:
    return Refused("bad_member", f"{name[:200]!r} cannot be a file in an archive: {why}")


@dataclass(frozen=True)
class ArchiveMemberRange:
    """The bytes [start, stop) of the content of member number `ordinal`."""

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
    """The members of an archive, in order: N names, sizes (N,) int64 and CRC-32 of contents (N,) uint32."""

    names: Sequence[str]
    sizes_bytes: NDArray[np.int64]
    crc32: NDArray[np.uint32]

    def entry(self, ordinal: int, offset: int = 0) -> ZipEntry:
        return ZipEntry(self.names[ordinal], int(self.sizes_bytes[ordinal]), int(self.crc32[ordinal]), offset)


@dataclass(frozen=True, eq=False)
class Archive:
    """An archive: `starts` (R + 1,) are the starts of its regions and its end; `region` returns the segments of a
    region.
    """

    starts: NDArray[np.int64]
    region: Callable[[int], Iterable[Segment]]

    @property
    def size_bytes(self) -> int:
        return int(self.starts[-1])

    def segments(self, start: int, stop: int) -> Iterator[Segment]:
        """Yield the non-empty segments of the bytes [start, stop), clipped to the archive."""
        first = int(np.searchsorted(self.starts, start, "right")) - 1
        position, number = int(self.starts[first]), first
        while position < min(stop, self.size_bytes):
            for segment in self.region(number):
                low, high = max(start - position, 0), min(stop - position, len(segment))
                if low < high:
                    yield segment[low:high]
                position += len(segment)
            number += 1


def layout(members: ArchiveMembers, kind: Kind) -> Archive:
    """Return the archive of these members; `check_names` must have accepted their names."""
    return _tar(members) if kind == "tar" else _zip(members)


def check_names(names: Iterable[str]) -> None:
    """Raise `bad_member` for an invalid path, a duplicate, or a name that is both a file and a folder.

    Names are compared case-insensitively, as on some disks.
    """
    files, folders = set[str](), set[str]()
    for name in names:
        if len(name) > MOST_NAME or not NAME.fullmatch(name):
            raise bad_member(
                name, f"names are relative paths of letters, digits and ._+=@-, shorter than {MOST_NAME} characters"
            )
        folded = name.casefold()
        if folded in files:
            raise bad_member(name, "another file has the same name")
        files.add(folded)
        folders |= {folded[:index] for index, sign in enumerate(folded) if sign == "/"}
    for both in sorted(files & folders):
        raise bad_member(both, "a folder has the same name")


def _tar(members: ArchiveMembers) -> Archive:
    """Return the archive of headers, contents padded to blocks, and zeros that fill the last record."""
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
    """Return the archive of local headers with stored contents, the central directory and the end records."""
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
    """Return the start of each consecutive region from 0, and the end of the last."""
    return np.concatenate([np.zeros(1, np.int64), np.cumsum(lengths, dtype=np.int64)])


# Index of a tar archive: the byte range of every file, read from the headers alone. Every length is compared with the
# file before it is used. Links and devices are refused, because exports contain none. Source of the extensions (pax
# records `path` and `size`, GNU long names, binary sizes): GNU tar manual, "Basic Tar Format".


MOST_EXTENSION_BYTES = 64 * 1024
MOST_FILES = 1 << 24
FILE, FOLDER, PAX, PAX_OF_ALL, LONG_NAME = (b"0", b"\0", b"7"), b"5", b"x", b"g", b"L"
RECORD = re.compile(rb"(\d{1,6}) ([^=\n]{1,200})=")


def bad_tar(path: Path, why: str) -> Refused:
    return Refused("bad_tar", f"{path} cannot be read as a tar: {why} (compressed or cut off? download it again)")


@dataclass(frozen=True)
class _Head:
    """A 512-byte header: name, size and kind of the content after it."""

    name: str
    size_bytes: int
    kind: bytes


def tar_spans_of(path: Path, is_wanted: Callable[[str], bool]) -> dict[str, tuple[int, int]]:
    """Return the offset and size of each wanted file by name. Like tar, use the last of several files with the same
    name.

    Raises `bad_tar`.
    """
    return {name: span for name, span in tar_members(path) if NAME.fullmatch(name) and is_wanted(name)}


def tar_members(path: Path) -> Iterator[tuple[str, tuple[int, int]]]:
    """Yield every file with its offset and size, without checking its name. Raises `bad_tar`."""
    with path.open("rb") as file:
        yield from _files(path, file.fileno())


def _files(path: Path, descriptor: int) -> Iterator[tuple[str, tuple[int, int]]]:
    size_bytes, offset, extension = os.fstat(descriptor).st_size, 0, dict[str, str]()
    for _ in range(MOST_FILES):
        block = os.pread(descriptor, BLOCK_BYTES, offset)
        if not block.strip(b"\0") and (offset or len(block) == BLOCK_BYTES):
            return
        head = _head(path, offset, block)
        length = int(extension["size"]) if head.kind in FILE and "size" in extension else head.size_bytes
        begin = offset + BLOCK_BYTES
        if begin + length > size_bytes:
            raise bad_tar(
                path, f"{head.name[:100]!r} would end at byte {begin + length}, but the file has {size_bytes} bytes"
            )
        offset = begin + length + -length % BLOCK_BYTES
        if head.kind in (PAX, LONG_NAME, PAX_OF_ALL):
            extension |= _extension(path, head, _content(path, descriptor, begin, length))
            continue
        if head.kind in FILE:
            yield (extension.get("path", head.name).removeprefix("./"), (begin, length))
        elif head.kind != FOLDER:
            raise bad_tar(path, f"{head.name[:100]!r} is a link or a device")
        extension = {}
    raise bad_tar(path, f"it contains more than {MOST_FILES} files")


def _head(path: Path, offset: int, block: bytes) -> _Head:
    if len(block) < BLOCK_BYTES:
        raise bad_tar(path, f"it ends inside the header at byte {offset}")
    blank = block[:148] + b" " * 8 + block[156:]
    if _number(path, block[148:156]) != sum(blank):
        raise bad_tar(path, f"the checksum of the header at byte {offset} is wrong")
    prefix = block[345:500].split(b"\0")[0] if block[257:263] == b"ustar\0" else b""
    parts = [part.decode("utf-8", "replace") for part in (prefix, block[:100].split(b"\0")[0]) if part]
    return _Head("/".join(parts), _number(path, block[124:136]), block[156:157])


def _number(path: Path, field: bytes) -> int:
    """Return the number in octal digits, or in base 256 if the first bit is set; an empty field is 0."""
    if field[0] == 0x80:
        return int.from_bytes(field[1:], "big")
    digits = field.strip(b" \0")
    if not re.fullmatch(rb"[0-7]*", digits):
        raise bad_tar(path, f"{field!r} is not a number")
    return int(digits or b"0", 8)


def _content(path: Path, descriptor: int, begin: int, length: int) -> bytes:
    if length > MOST_EXTENSION_BYTES:
        raise bad_tar(path, f"a name has {length} bytes, more than the limit")
    return os.pread(descriptor, length, begin)


def _extension(path: Path, head: _Head, content: bytes) -> dict[str, str]:
    """Return the path and size that an extension record assigns to the next file."""
    if head.kind == LONG_NAME:
        return {"path": content.rstrip(b"\0").decode("utf-8", "replace")}
    records, offset = dict[str, str](), 0
    while head.kind == PAX and offset < len(content):
        match = RECORD.match(content, offset)
        end = offset + int(match[1]) if match else 0
        if match is None or not match.end() < end <= len(content) or content[end - 1 : end] != b"\n":
            raise bad_tar(path, f"the record at byte {offset} of {head.name[:100]!r} is malformed")
        records[match[2].decode("utf-8", "replace")] = content[match.end() : end - 1].decode("utf-8", "replace")
        offset = end
    if "size" in records and not re.fullmatch(r"[0-9]{1,18}", records["size"]):
        raise bad_tar(path, f"{records['size'][:40]!r} is not a size")
    return {key: value for key, value in records.items() if key in ("path", "size")}
