"""The object store interface, implemented by a local folder and by an S3 bucket.

**Conventions.** A key is `<kind>/<…>` of [a-z0-9._/-]; an object appears whole or not at all and is never changed. The
store knows nothing of meaning: what is referenced by whom is in the database (`services/runtime/store/blobs.py`).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol


@dataclass(frozen=True)
class StoredObject:
    """An object as listed."""

    key: str
    size_bytes: int
    modified_ns: int


class Store(Protocol):
    """Objects by key. `ObjectMissingError` where there is none."""

    def __hash__(self) -> int:
        """By identity: what was read of a store may be kept by it."""
        ...

    def write(self, key: str, source: Path) -> None:
        """Store a copy of the file `source`."""
        ...

    def adopt(self, key: str, source: Path) -> None:
        """Store `source`, which nobody will change any more, without a copy where possible (a hard link).

        `source` stays, so that nothing is lost before the caller's commit; it may be removed after that.
        """
        ...

    def read(self, key: str, start: int = 0, stop: int | None = None) -> Iterator[bytes]:
        """The bytes [start, stop) in pieces."""
        ...

    def size_bytes(self, key: str) -> int: ...

    def local(self, key: str) -> Path:
        """A file on this machine with the object's bytes, to be read only; it may be a cached copy."""
        ...

    def forget_copy(self, key: str) -> None:
        """Make `local` read the object again, because this machine's copy, if there is one, is damaged."""
        ...

    def delete(self, key: str) -> None:
        """Remove the object; nothing happens where there is none."""
        ...

    def listed(self, prefix: str) -> Iterator[StoredObject]:
        """All objects whose key begins with `prefix`, in the order of their keys."""
        ...

    def tidy(self, grace_s: float) -> int:
        """Remove what writers that died left half-way, once older than the grace; how many there were."""
        ...
