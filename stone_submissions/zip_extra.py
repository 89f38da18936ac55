"""The extra fields of a zip's headers: wide sizes, and a second name that must not be another.

**Conventions.** Extra fields are (tag, length, value) one after another; up to three zero bytes of padding may follow.

Source: PKWARE APPNOTE 6.3.10, §4.5.1, 4.5.3 (zip64), 4.6.9 (Unicode path).
"""

import struct

from stone_submissions.errors import TruncatedError, UnsupportedZipError
from stone_submissions.zip_end import IN_EXTRA_32

ZIP64_TAG, UNICODE_PATH_TAG = 0x0001, 0x7075
FIELD = struct.Struct("<2H")
BEFORE_THE_PATH = 5  # a version and the CRC-32 of the name in the header


def extra_fields(extra: bytes, name: str) -> dict[int, bytes]:
    """The value of each tag. Raises `TruncatedError`; `UnsupportedZipError` where a tag that we read is there twice."""
    fields: dict[int, bytes] = {}
    at = 0
    while at + FIELD.size <= len(extra):
        tag, count = FIELD.unpack_from(extra, at)
        value = extra[at + FIELD.size : at + FIELD.size + count]
        if len(value) < count:
            raise TruncatedError(f"an extra field of {count} bytes for {name!r}", f"{len(value)}")
        if tag in fields and tag in (ZIP64_TAG, UNICODE_PATH_TAG):
            raise UnsupportedZipError(f"each extra field of {name!r} once", f"field {tag:#06x} again")
        fields[tag] = value
        at += FIELD.size + count
    return fields


def wide_values(fields: dict[int, bytes], values: tuple[int, ...], name: str) -> tuple[int, ...]:
    """`values`, those that are 0xFFFFFFFF replaced, in this order, by the 8-byte ones of the zip64 field.

    Raises `TruncatedError` where there are fewer.
    """
    needed = sum(value == IN_EXTRA_32 for value in values)
    wide = fields.get(ZIP64_TAG, b"")
    if len(wide) < 8 * needed:
        raise TruncatedError(f"{needed} zip64 values for {name!r}", f"{len(wide)} bytes")
    found = iter(struct.unpack_from(f"<{needed}Q", wide))
    return tuple(next(found) if value == IN_EXTRA_32 else value for value in values)


def check_other_name(fields: dict[int, bytes], name: str) -> None:
    """Raises `UnsupportedZipError` where a Unicode path names another file than the header: readers would differ.

    Folders may differ: Info-ZIP writes them so, since the header has no character for some.
    """
    path = fields.get(UNICODE_PATH_TAG)
    if path is not None and path[BEFORE_THE_PATH:].rpartition(b"/")[2] != name.rpartition("/")[2].encode():
        raise UnsupportedZipError(f"one name for {name!r}", f"another in field {UNICODE_PATH_TAG:#06x}")
