"""Where bytes live: a seam with two real implementations, a local folder and an S3 bucket.

**Conventions.** A key is `<kind>/<…>` of [a-z0-9._/-]; an object appears whole or not at all and is never changed. The
store knows nothing of meaning: what is referenced by whom is in the database (`services/runtime/blobs.py`).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from services.runtime.settings import Settings


@dataclass(frozen=True)
class Stored:
    """An object as listed."""

    key: str
    size_bytes: int
    modified_ns: int


class Store(Protocol):
    """Objects by key. `ObjectMissingError` where there is none."""

    def write(self, key: str, source: Path) -> None:
        """Store a copy of the file `source`."""
        ...

    def adopt(self, key: str, source: Path) -> None:
        """Store `source` and remove it; on the same filesystem this is a rename."""
        ...

    def read(self, key: str, start: int = 0, stop: int | None = None) -> Iterator[bytes]:
        """The bytes [start, stop) in pieces."""
        ...

    def size_bytes(self, key: str) -> int: ...

    def local(self, key: str) -> Path:
        """A file on this machine with the object's bytes, to be read only; it may be a cached copy."""
        ...

    def delete(self, key: str) -> None:
        """Remove the object; nothing happens where there is none."""
        ...

    def listed(self, prefix: str) -> Iterator[Stored]:
        """All objects whose key begins with `prefix`, in the order of their keys."""
        ...


def open_store(settings: Settings) -> Store:
    """The store these settings name."""
    from services.runtime.store_folder import FolderStore
    from services.runtime.store_s3 import S3Store

    return S3Store(settings) if settings.store.s3_bucket else FolderStore(settings.root / "store")
