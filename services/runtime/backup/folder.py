"""The folder of backups: contents by sha256, once for all snapshots, and the snapshots beside them.

**Conventions.** Writers hold the lock of the folder; readers need none, since files there never change. A content is
written to a temporary file, flushed and renamed.
"""

import fcntl
import hashlib
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from secrets import token_hex

from services.runtime.backup.errors import DamagedBackupError, SourceDamagedError
from stone.errors import Refused
from stone_files.atomic import atomic_directory, flush

PIECE_BYTES = 2**20
OBJECTS, SNAPSHOTS, STAGING, LOCK = "objects", "snapshots", ".staging", "lock"


@dataclass(frozen=True)
class BackupContent:
    """Bytes, identified by their sha256 and size."""

    sha256: str
    size_bytes: int


class BackupFolder:
    """Backups below `root`, which the first writer creates, accessible only to its owner."""

    def __init__(self, root: Path) -> None:
        self.root = root

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Hold the folder's lock and delete partial files of dead writers. Raises `backup_busy`."""
        for folder in (self.root, self.root / OBJECTS, self.root / SNAPSHOTS, self.root / STAGING):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        descriptor = os.open(self.root / LOCK, os.O_CREAT | os.O_RDWR, 0o600)
        try:
            self._lock(descriptor)
            for half in (self.root / STAGING).iterdir():
                half.unlink()
            for half in (self.root / SNAPSHOTS).glob(".*"):  # names are unique: no later snapshot replaces it
                shutil.rmtree(half)
            yield
        finally:
            os.close(descriptor)

    def snapshots(self) -> list[str]:
        """Return the names of the complete snapshots, oldest first."""
        folder = self.root / SNAPSHOTS
        return sorted(entry.name for entry in folder.iterdir() if entry.name[0] != ".") if folder.is_dir() else []

    def snapshot(self, name: str = "") -> Path:
        """Return the folder of a snapshot (default: the newest). Raises `snapshot_missing`."""
        names = self.snapshots()
        if not names or (name and name not in names):
            raise snapshot_missing(self.root, name, names)
        return self.root / SNAPSHOTS / (name or names[-1])

    @contextmanager
    def new_snapshot(self) -> Iterator[Path]:
        """Yield a folder to fill, which becomes a snapshot at the end, or is deleted on an error."""
        name = datetime.now(UTC).strftime("%Y-%m-%dT%H%M%S.%fZ")
        with atomic_directory(self.root / SNAPSHOTS / name) as staging:
            yield staging

    def path_of(self, sha256: str) -> Path:
        return self.root / OBJECTS / sha256[:2] / sha256

    def has(self, content: BackupContent) -> bool:
        try:
            return self.path_of(content.sha256).stat().st_size == content.size_bytes
        except FileNotFoundError:
            return False

    def add(self, name: str, pieces: Iterable[bytes], expected_sha256: str = "") -> BackupContent:
        """Store a content. Raises `SourceDamagedError`, which contains `name`, if its hash is not the expected one."""
        staging, hashed, size_bytes = self.root / STAGING / token_hex(8), hashlib.sha256(), 0
        try:
            with staging.open("xb") as file:
                for piece in pieces:
                    hashed.update(piece)
                    size_bytes += file.write(piece)
                file.flush()
                os.fsync(file.fileno())
            digest = hashed.hexdigest()
            if expected_sha256 not in ("", digest):
                raise SourceDamagedError(name, digest, expected_sha256)
            self._place(staging, self.path_of(digest))
            return BackupContent(digest, size_bytes)
        finally:
            staging.unlink(missing_ok=True)

    def checked(self, content: BackupContent) -> Path:
        """Return the file of a content after reading and comparing it. Raises `DamagedBackupError`."""
        path = self.path_of(content.sha256)
        if not path.is_file():
            raise DamagedBackupError(path, "is missing")
        if sha256_of(path) != content.sha256:
            raise DamagedBackupError(path, "differs from the hash in its name")
        return path

    def contents(self) -> Iterator[Path]:
        yield from sorted((self.root / OBJECTS).glob("??/*"))

    def _lock(self, descriptor: int) -> None:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise Refused(
                "backup_busy", f"another backup is running in {self.root}; wait for it, or choose another folder"
            ) from None

    def _place(self, staging: Path, target: Path) -> None:
        target.parent.mkdir(mode=0o700, exist_ok=True)
        os.replace(staging, target)
        flush(target.parent)


def sha256_of(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def pieces_of(path: Path, size_bytes: int | None = None) -> Iterator[bytes]:
    """Yield the first `size_bytes` of a file (default: all)."""
    left = path.stat().st_size if size_bytes is None else size_bytes
    with path.open("rb") as file:
        while left and (piece := file.read(min(PIECE_BYTES, left))):
            left -= len(piece)
            yield piece


def snapshot_missing(folder: Path, name: str, existing: list[str]) -> Refused:
    wanted = f"snapshot {name!r}" if name else "snapshot"
    return Refused("snapshot_missing", f"{folder} has no {wanted}; it has {', '.join(existing[-5:]) or 'none'}")
