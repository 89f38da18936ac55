"""The object store interface, implemented by a local folder and by an S3 bucket.

**Conventions.** A key is `<kind>/<…>` of [a-z0-9._/-]; an object appears whole or not at all and never changes. The
store contains bytes only: the database records all references (`services/runtime/store/blobs.py`).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol


@dataclass(frozen=True)
class StoredObject:
    """An object in a listing."""

    key: str
    size_bytes: int
    modified_ns: int


class Store(Protocol):
    """Objects by key. Methods raise `ObjectMissingError` if the key has no object."""

    def __hash__(self) -> int:
        """Return a hash by identity: caches may use a store as their key."""
        ...

    def write(self, key: str, source: Path) -> None:
        """Store a copy of the file `source`."""
        ...

    def adopt(self, key: str, source: Path) -> None:
        """Store `source`, which will not change any more, without a copy if possible (a hard link).

        `source` stays until the caller's commit, so nothing is lost before it; it may be deleted afterwards.
        """
        ...

    def read(self, key: str, start: int = 0, stop: int | None = None) -> Iterator[bytes]:
        """Yield the bytes [start, stop) in pieces."""
        ...

    def size_bytes(self, key: str) -> int: ...

    def local(self, key: str) -> Path:
        """Return a local file with the object's bytes, for reading only; it may be a cached copy."""
        ...

    def forget_copy(self, key: str) -> None:
        """Make `local` read the object again, because this machine's copy, if there is one, is damaged."""
        ...

    def delete(self, key: str) -> None:
        """Delete the object, if it exists."""
        ...

    def listed(self, prefix: str) -> Iterator[StoredObject]:
        """Yield all objects whose key starts with `prefix`, in the order of their keys."""
        ...

    def tidy(self, grace_s: float) -> int:
        """Delete unfinished files of dead writers older than the grace; return their number."""
        ...
