"""The upload backend interface, implemented by a shared folder and by the object store.

**Conventions.** An upload's row says in which backend its bytes are. A backend knows bytes and offsets; states, quotas
and owners are the rows' (`rows.py`), and a row changes before its bytes go. Whoever holds bytes reads the row again.
"""

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

from sqlalchemy.orm import Session

from services.runtime.orm import Upload


class LockedUpload(Protocol):
    """The bytes of an upload, held by one request: `append` what comes, `accept` or `discard` it, then `close`."""

    @property
    def kept_bytes(self) -> int:
        """The number of bytes that stay when this process is killed now."""
        ...

    def mark_unverified(self) -> None:
        """Let what is appended from now on not count until `accept`, even when the process is killed before."""
        ...

    def append(self, pieces: Sequence[bytes], offset_bytes: int) -> None:
        """Add `pieces` at `offset_bytes`, the end of what was appended. Raises `DiskFullError`; what fitted counts."""
        ...

    def accept(self, *, is_whole: bool) -> None:
        """All that was appended counts; a whole upload survives a power cut from now on. Raises `DiskFullError`."""
        ...

    def discard(self) -> None:
        """Drop what was appended and not accepted, as far as it is not kept for ever already."""
        ...

    def sha256(self) -> str:
        """The hash of all bytes, read again from the first one; in hex."""
        ...

    def close(self) -> None:
        """Let go. May be called twice."""
        ...


class UploadBackend(Protocol):
    """Bytes under way by upload; `FileNotFoundError` where those of an upload are gone."""

    def begin(self, upload: Upload) -> bool:
        """Make room before the row comes to be; true when the owner's own file has given it all its bytes already.

        Raises `DiskFullError`.
        """
        ...

    def enter(self, session: Session, upload: Upload) -> bool:
        """Within the transaction that makes the row, after it: as `begin`, for a backend whose bytes have rows."""
        ...

    def offset_of(self, upload_id: str) -> int:
        """The number of bytes that count."""
        ...

    def hold(self, upload: Upload) -> LockedUpload:
        """Raises `UploadLockedError` while another request holds them."""
        ...

    def remove(self, upload_id: str) -> None:
        """The bytes go; nothing happens where there are none."""
        ...

    def local(self, upload: Upload) -> AbstractContextManager[Path]:
        """A file on this machine with all bytes of a whole upload, to be read only; a copy goes with the block."""
        ...

    def holding(self) -> Iterator[str]:
        """The uploads that have bytes here, in no order, found as they are asked for: over minutes, if need be."""
        ...

    def is_forgotten(self, upload_id: str) -> bool:
        """Whether bytes without a row are so old that no row is about to come."""
        ...
