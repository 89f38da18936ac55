"""Tar headers: one ustar block per file, preceded by a pax record for long names and large sizes.

**Conventions.** Names are ASCII. Every file is 0644, of user and group 0, of 1980-01-01.

Source: POSIX.1-2017 pax, "ustar Interchange Format", "pax Extended Header".
"""

import struct
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

BLOCK_BYTES = 512
RECORD_BYTES = 20 * BLOCK_BYTES
END_BYTES = 2 * BLOCK_BYTES
MOST_USTAR_BYTES = 8**11 - 1
MODIFIED_S = 315_532_800  # 1980-01-01, as in a zip; tar warns of the implausible 1970
NAME_BYTES, PREFIX_BYTES = 100, 155
FORM = struct.Struct("<100s8s8s8s12s12s8sc100s6s2s32s32s8s8s155s12s")
CHECKSUM_AT = 148
Sizes = TypeVar("Sizes", np.int64, NDArray[np.int64])


def padding_bytes(sizes_bytes: Sizes) -> Sizes:
    """How many zeros follow contents of these sizes."""
    return -sizes_bytes % BLOCK_BYTES


def tar_head_bytes(name: str, size_bytes: int) -> int:
    """The length of `tar_head(name, size_bytes)`."""
    if size_bytes <= MOST_USTAR_BYTES and (len(name) <= NAME_BYTES or _split(name)):
        return BLOCK_BYTES
    record = len(_pax(name, size_bytes))
    return 2 * BLOCK_BYTES + record + -record % BLOCK_BYTES


def tar_head(name: str, size_bytes: int) -> bytes:
    """What stands before the content of a file."""
    place = ("", name) if len(name) <= NAME_BYTES else _split(name)
    if place and size_bytes <= MOST_USTAR_BYTES:
        return _block(place, size_bytes, b"0")
    record = _pax(name, size_bytes)
    padded = record + bytes(-len(record) % BLOCK_BYTES)
    shown = ("", name[-NAME_BYTES:].lstrip("/"))
    ustar_bytes = size_bytes if size_bytes <= MOST_USTAR_BYTES else 0  # readers take it from the record
    return _block(("", "PaxHeader"), len(record), b"x") + padded + _block(shown, ustar_bytes, b"0")


def _split(name: str) -> tuple[str, str] | None:
    """Prefix and name at the last slash that leaves room for both; None where there is none."""
    at = name.rfind("/", 0, PREFIX_BYTES + 1)
    if at <= 0 or len(name) - at - 1 > NAME_BYTES:
        return None
    return name[:at], name[at + 1 :]


def _pax(name: str, size_bytes: int) -> bytes:
    """`path` and `size` as records `<length> <key>=<value>` and a newline, the length counting itself."""
    return _record("path", name) + _record("size", str(size_bytes))


def _record(key: str, value: str) -> bytes:
    rest = f" {key}={value}\n"
    length = len(rest)
    while len(str(length)) + len(rest) != length:
        length = len(str(length)) + len(rest)
    return f"{length}{rest}".encode("ascii")


def _block(place: tuple[str, str], size_bytes: int, kind: bytes) -> bytes:
    prefix, name = (part.encode("ascii") for part in place)
    numbers = (b"0000644\0", b"0000000\0", b"0000000\0", b"%011o\0" % size_bytes, b"%011o\0" % MODIFIED_S)
    owner = (b"ustar\0", b"00", b"", b"", b"0000000\0", b"0000000\0")
    block = FORM.pack(name, *numbers, b" " * 8, kind, b"", *owner, prefix, b"")
    return block[:CHECKSUM_AT] + b"%06o\0 " % sum(block) + block[CHECKSUM_AT + 8 :]
