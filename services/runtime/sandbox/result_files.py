"""The result of sandboxed work: one JSON record and files, validated before use.

**Conventions.** Four bytes of length (little-endian), that much JSON `{"record": {...}, "files": [[name, media type,
bytes], ...]}`, then the files one after another. The caller validates the record. Names are plain here and media types
known, so a file can be stored and served as its media type.
"""

import json
import re
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from services.runtime.sandbox.errors import SandboxCrashedError

HEAD = struct.Struct("<I")
LONGEST_JSON_BYTES = 16 * 2**20
MOST_FILES = 64
NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,99}")
MEDIA_TYPES = ("application/json", "image/jpeg", "image/png", "text/html")

File = tuple[str, str, bytes]


@dataclass(frozen=True)
class SandboxResult:
    """`record` is a JSON object created by the child; `files` are (name, media type, bytes)."""

    record: dict[str, Any]
    files: tuple[File, ...] = ()


def packed(record: dict[str, Any], files: Iterable[File] = ()) -> bytes:
    """Return the result as bytes. Raises `ValueError` for NaN and infinities in the record."""
    kept = tuple(files)[:MOST_FILES]
    listed = [[name, media_type, len(content)] for name, media_type, content in kept]
    head = json.dumps({"record": record, "files": listed}, allow_nan=False).encode()
    return b"".join([HEAD.pack(len(head)), head, *(content for _, _, content in kept)])


def unpacked(answer: bytes) -> SandboxResult:
    """Return the result from its bytes. Raises `SandboxCrashedError` for a malformed result."""
    if len(answer) < HEAD.size or HEAD.unpack_from(answer)[0] > min(len(answer) - HEAD.size, LONGEST_JSON_BYTES):
        raise _malformed()
    start = HEAD.size + HEAD.unpack_from(answer)[0]
    try:
        head = json.loads(answer[HEAD.size : start])
    except (ValueError, RecursionError):
        raise _malformed() from None
    match head:
        case {"record": dict(record), "files": list(listed)} if len(listed) <= MOST_FILES:
            return SandboxResult(record, tuple(_files(listed, answer, start)))
    raise _malformed()


def _files(listed: list[Any], answer: bytes, start: int) -> Iterable[File]:
    for entry in listed:
        match entry:
            case [str(name), str(media_type), int(length)] if NAME.fullmatch(name) and media_type in MEDIA_TYPES:
                stop = start + length
            case _:
                raise _malformed()
        if not start <= stop <= len(answer):
            raise _malformed()
        yield name, media_type, answer[start:stop]
        start = stop
    if start != len(answer):
        raise _malformed()


def _malformed() -> SandboxCrashedError:
    return SandboxCrashedError("sent a malformed result")
