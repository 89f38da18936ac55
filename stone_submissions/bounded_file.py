"""Reads a small file whole, if it is as small as it must be."""

from collections.abc import Callable
from pathlib import Path

from stone_base.errors import StoneError
from stone_submissions.errors import UnreadableInputError


def read_bounded(path: Path, limit_bytes: int, refusal: Callable[[Path, str], StoneError]) -> bytes:
    """The bytes of this file; nothing beyond `limit_bytes` is read.

    Raises `UnreadableInputError` where it cannot be opened, and `refusal(path, fault)` where it is larger.
    """
    try:
        with path.open("rb") as file:
            content = file.read(limit_bytes + 1)
    except OSError as error:
        raise UnreadableInputError(path, error.strerror or "unknown reason") from error
    if len(content) > limit_bytes:
        raise refusal(path, f"larger than {limit_bytes} bytes")
    return content
