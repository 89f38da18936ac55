"""Validation of store keys, and the store's errors.

**Conventions.** A key is `<kind>/<…>`: at least two parts of [a-z0-9._-], no part starting with a dot, at most 512
characters. So every key stays within the store's folder, is visible, and means the same on every filesystem.
"""

import re
from pathlib import Path

from stone.errors import PlatformFaultError, Refused, StoneError

MAX_KEY = 512
_PART = "[a-z0-9_-][a-z0-9._-]*"
_KEY = re.compile(rf"{_PART}(/{_PART})+")
_PREFIX = re.compile(rf"({_PART}/)*({_PART})?")


def bad_key(key: str) -> Refused:
    return Refused(
        "bad_key",
        f"{key[:200]!r} is not an object key; expected at most {MAX_KEY} characters, two or more parts of "
        "[a-z0-9._-] joined by '/', no part starting with a dot",
    )


class ObjectMissingError(StoneError):
    """The store has no object with this key."""

    code = "object_missing"

    def __init__(self, key: str) -> None:
        super().__init__(
            f"the store contains no object {key!r}; it was deleted, or the store belongs to another installation"
        )


class StoreFullError(PlatformFaultError):
    """The store, or the local cache in front of it, has no space left."""

    def __init__(self, place: Path | str) -> None:
        super().__init__("store_full", f"no space left at {place}; free space or raise the quota, and try again")


def is_key(key: str) -> bool:
    """Return whether an object could have this key."""
    return len(key) <= MAX_KEY and _KEY.fullmatch(key) is not None


def checked(key: str) -> str:
    """Return `key`. Raises `bad_key`."""
    if not is_key(key):
        raise bad_key(key)
    return key


def checked_prefix(prefix: str) -> str:
    """Return `prefix`, which may be empty or end anywhere within a key. Raises `bad_key`."""
    if len(prefix) > MAX_KEY or not _PREFIX.fullmatch(prefix):
        raise bad_key(prefix)
    return prefix


def checked_range(start: int, stop: int | None) -> None:
    """Raise `ValueError` unless 0 ≤ start ≤ stop."""
    if start < 0 or (stop is not None and stop < start):
        raise ValueError(f"bad byte range [{start}, {stop}): expected 0 <= start <= stop")
