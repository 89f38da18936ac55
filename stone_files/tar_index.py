"""Index of a tar archive: the byte range of every file, read from its headers alone.

**Conventions.** ustar with the extensions that writers use: pax records `path` and `size`, GNU long names and binary
sizes. Every length is compared with the file before it is read. Links and devices are refused: an export has none.
Source: POSIX.1-2017 pax, "ustar Interchange Format"; GNU tar manual, "Basic Tar Format".
"""

import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from stone_base.errors import StoneError
from stone_files.virtual_archive import NAME

BLOCK_BYTES = 512
MOST_EXTENSION_BYTES = 64 * 1024
MOST_FILES = 1 << 24
FILE, FOLDER, PAX, PAX_OF_ALL, LONG_NAME = (b"0", b"\0", b"7"), b"5", b"x", b"g", b"L"
RECORD = re.compile(rb"(\d{1,6}) ([^=\n]{1,200})=")


class BadTarError(StoneError):
    """The file is not a tar that could be an export."""

    code: ClassVar[str] = "bad_tar"

    def __init__(self, path: Path, why: str) -> None:
        super().__init__(f"{path} cannot be read as a tar: {why} (is it compressed, or cut off? download it again)")


@dataclass(frozen=True)
class _Head:
    """One 512-byte block: what it says of the content after it."""

    name: str
    size_bytes: int
    kind: bytes


def tar_spans_of(path: Path, is_wanted: Callable[[str], bool]) -> dict[str, tuple[int, int]]:
    """Offset and size of each file that is wanted, by name; of two of one name the last, as tar unpacks them.

    Raises `BadTarError`.
    """
    return {name: place for name, place in tar_members(path) if NAME.fullmatch(name) and is_wanted(name)}


def tar_members(path: Path) -> Iterator[tuple[str, tuple[int, int]]]:
    """Every file with its offset and size, whatever its name. Raises `BadTarError`."""
    with path.open("rb") as file:
        yield from _files(path, file.fileno())


def _files(path: Path, descriptor: int) -> Iterator[tuple[str, tuple[int, int]]]:
    size_bytes, place, said = os.fstat(descriptor).st_size, 0, dict[str, str]()
    for _ in range(MOST_FILES):
        block = os.pread(descriptor, BLOCK_BYTES, place)
        if not block.strip(b"\0") and (place or len(block) == BLOCK_BYTES):
            return
        head = _head(path, place, block)
        length = int(said["size"]) if head.kind in FILE and "size" in said else head.size_bytes
        begin = place + BLOCK_BYTES
        if begin + length > size_bytes:
            raise BadTarError(path, f"{head.name[:100]!r} should end at byte {begin + length} of {size_bytes}")
        place = begin + length + -length % BLOCK_BYTES
        if head.kind in (PAX, LONG_NAME, PAX_OF_ALL):
            said |= _extension(path, head, _content(path, descriptor, begin, length))
            continue
        if head.kind in FILE:
            yield (said.get("path", head.name).removeprefix("./"), (begin, length))
        elif head.kind != FOLDER:
            raise BadTarError(path, f"{head.name[:100]!r} is a link or a device")
        said = {}
    raise BadTarError(path, f"it has more than {MOST_FILES} files")


def _head(path: Path, place: int, block: bytes) -> _Head:
    if len(block) < BLOCK_BYTES:
        raise BadTarError(path, f"it ends in the header at byte {place}")
    blank = block[:148] + b" " * 8 + block[156:]
    if _number(path, block[148:156]) != sum(blank):
        raise BadTarError(path, f"the checksum of the header at byte {place} is wrong")
    prefix = block[345:500].split(b"\0")[0] if block[257:263] == b"ustar\0" else b""
    parts = [part.decode("utf-8", "replace") for part in (prefix, block[:100].split(b"\0")[0]) if part]
    return _Head("/".join(parts), _number(path, block[124:136]), block[156:157])


def _number(path: Path, field: bytes) -> int:
    """Octal digits, or base 256 where the first bit is set; none is zero."""
    if field[0] == 0x80:
        return int.from_bytes(field[1:], "big")
    digits = field.strip(b" \0")
    if not re.fullmatch(rb"[0-7]*", digits):
        raise BadTarError(path, f"{field!r} is not a number")
    return int(digits or b"0", 8)


def _content(path: Path, descriptor: int, begin: int, length: int) -> bytes:
    if length > MOST_EXTENSION_BYTES:
        raise BadTarError(path, f"a name of {length} bytes")
    return os.pread(descriptor, length, begin)


def _extension(path: Path, head: _Head, content: bytes) -> dict[str, str]:
    """The path and the size that an extension record gives the file after it."""
    if head.kind == LONG_NAME:
        return {"path": content.rstrip(b"\0").decode("utf-8", "replace")}
    said, place = dict[str, str](), 0
    while head.kind == PAX and place < len(content):
        found = RECORD.match(content, place)
        end = place + int(found[1]) if found else 0
        if found is None or not found.end() < end <= len(content) or content[end - 1 : end] != b"\n":
            raise BadTarError(path, f"the record at byte {place} of {head.name[:100]!r} is malformed")
        said[found[2].decode("utf-8", "replace")] = content[found.end() : end - 1].decode("utf-8", "replace")
        place = end
    if "size" in said and not re.fullmatch(r"[0-9]{1,18}", said["size"]):
        raise BadTarError(path, f"{said['size'][:40]!r} is not a size")
    return {key: value for key, value in said.items() if key in ("path", "size")}
