"""An unnamed temporary file for received bytes that are not yet in the store."""

import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile

from services.runtime.uploads.errors import DiskFullError
from services.runtime.uploads.files import refusing_full, write_all


class Spool:
    """Bytes on this machine's disk, to be stored as one object from `path`."""

    def __init__(self, folder: Path, reserve_bytes: int) -> None:
        """Open the spool. Raises `DiskFullError`."""
        self._reserve_bytes = reserve_bytes
        with refusing_full(lambda: 0):
            folder.mkdir(parents=True, exist_ok=True)
            self._file = TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115 - closed by whoever stores it
        self.size_bytes = 0

    @property
    def path(self) -> Path:
        """A path that leads to the file while it is open in this process."""
        return Path(f"/proc/self/fd/{self._file.fileno()}")

    def write(self, pieces: Sequence[memoryview]) -> None:
        """Add all pieces, or none. Raises `DiskFullError`."""
        try:
            with refusing_full(lambda: self.size_bytes):
                self.size_bytes = write_all(self._file.fileno(), pieces, self.size_bytes, self._reserve_bytes)
        except DiskFullError:
            os.ftruncate(self._file.fileno(), self.size_bytes)
            raise

    def close(self) -> None:
        with suppress(OSError):
            self._file.close()


def split(pieces: Sequence[memoryview], room_bytes: int) -> tuple[list[memoryview], list[memoryview]]:
    """Return the first `room_bytes` of the pieces, and the rest."""
    fitting: list[memoryview] = []
    for index, piece in enumerate(pieces):
        if len(piece) >= room_bytes:
            rest = [piece[room_bytes:], *pieces[index + 1 :]]
            return [*fitting, piece[:room_bytes]], [view for view in rest if view]
        fitting.append(piece)
        room_bytes -= len(piece)
    return fitting, []
