"""The reserve: free space that bulk data never takes, so that rows can always be written.

**Conventions.** Uploads, the files of jobs, downloads into the cache and backups check the free space before they
write. Each file system has a reserve: `STONE_STORE__RESERVE_BYTES`, or by default the larger of a twentieth of the file
system and 2 GiB. A bucket has no reserve.
"""

import os
from dataclasses import dataclass
from pathlib import Path

from services.runtime.store.keys import StoreFullError
from stone.errors import PlatformFaultError

AUTOMATIC = 0
"""The value of the setting that means the larger of `SHARE` of the file system and `LEAST_BYTES`."""
NO_RESERVE = 1
SHARE = 20
LEAST_BYTES = 2 << 30


class StorageFullError(StoreFullError):
    """Writing more bytes would use the reserve."""

    def __init__(self, space: "FreeSpace", more_bytes: int) -> None:
        PlatformFaultError.__init__(
            self,
            "storage_full",
            f"cannot write {more_bytes} bytes: the platform's disk has {space.free_bytes} bytes free, including a "
            f"reserve of {space.reserve_bytes} bytes (STONE_STORE__RESERVE_BYTES). Delete uploads, label sets, "
            "exports or sequences that are no longer needed, or enlarge the disk, and try again",
        )


@dataclass(frozen=True)
class FreeSpace:
    """The free space of a file system, and its reserve."""

    free_bytes: int
    reserve_bytes: int

    def takes(self, more_bytes: int) -> bool:
        return self.free_bytes - more_bytes >= self.reserve_bytes


def free_space(place: Path | int, reserve_bytes: int = AUTOMATIC) -> FreeSpace:
    """Return the space on the file system of a folder, which need not exist yet, or of an open file."""
    if isinstance(place, Path):
        facts = os.statvfs(next(path for path in (place, *place.parents) if path.exists()))
    else:
        facts = os.fstatvfs(place)
    automatic = max(facts.f_blocks * facts.f_frsize // SHARE, LEAST_BYTES)
    return FreeSpace(facts.f_bavail * facts.f_frsize, automatic if reserve_bytes == AUTOMATIC else reserve_bytes)


def require_room(place: Path | int, more_bytes: int, reserve_bytes: int) -> None:
    """Raise `StorageFullError` unless `more_bytes` can be written to `place` and the reserve stays free."""
    space = free_space(place, reserve_bytes)
    if not space.takes(more_bytes):
        raise StorageFullError(space, more_bytes)
