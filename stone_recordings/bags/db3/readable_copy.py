"""Read-only access to a SQLite database: in place, or as a private copy with its journal.

**Conventions.** A sound database is opened where it lies, as immutable. What a crash leaves beside it is applied in a
private folder: a write-ahead log (`-wal`) to the same bytes under another name, a rollback journal (`-journal`) to a
copy. A journal that names other files is never applied: SQLite would delete them.
"""

import os
from dataclasses import dataclass
from pathlib import Path

from stone.findings import Finding
from stone_recordings.bags.errors import DatabaseRefusedError
from stone_recordings.bags.magic import has_wal
from stone_recordings.bags.private_folder import PrivateFolder

JOURNAL_MAGIC = b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7"
JOURNAL_BYTES = 512  # the smallest journal is one sector


@dataclass(frozen=True)
class Db3Location:
    """Open `path`; `is_clean` where nothing lay beside it, so that it may be opened as immutable."""

    path: Path
    is_clean: bool
    folder: PrivateFolder | None
    findings: tuple[Finding, ...]

    @property
    def wal(self) -> Path | None:
        wal = _beside(self.path, "-wal")
        return wal if wal.is_file() and wal.stat().st_size else None

    def close(self) -> None:
        if self.folder is not None:
            self.folder.close()


def db3_location_of(path: Path) -> Db3Location:
    """Raises: DatabaseRefusedError, NoRoomError."""
    journal = _beside(path, "-journal")
    if has_wal(path):
        return _with_wal(path)
    if _is_hot(journal):
        return _with_journal(path, journal)
    return Db3Location(path, is_clean=True, folder=None, findings=())


def _with_wal(path: Path) -> Db3Location:
    wal, folder = _beside(path, "-wal"), PrivateFolder()
    try:
        placed = folder.link_or_copy(path)
        folder.copy(wal)
    except BaseException:
        folder.close()
        raise
    message = f"{path.name} was not closed: the {wal.stat().st_size} bytes of its -wal file are read with it."
    return Db3Location(
        placed, is_clean=False, folder=folder, findings=(Finding("BAG-029", "warning", path.name, message),)
    )


def _with_journal(path: Path, journal: Path) -> Db3Location:
    if _names_other_files(journal):
        raise DatabaseRefusedError(path.name, "the -journal beside it names other files, no recorder's does")
    folder = PrivateFolder()
    try:
        placed = folder.copy(path)
        placed.chmod(0o600)
        folder.copy(journal)
    except BaseException:
        folder.close()
        raise
    message = f"{path.name} was not closed: the transaction that its -journal file holds was undone in a copy."
    return Db3Location(
        placed, is_clean=False, folder=folder, findings=(Finding("BAG-029", "warning", path.name, message),)
    )


def _names_other_files(journal: Path) -> bool:
    """The name of a super-journal ends, with this mark, at the end of the file (pager.c, readSuperJournal)."""
    with journal.open("rb") as file:
        file.seek(-len(JOURNAL_MAGIC), os.SEEK_END)
        return file.read() == JOURNAL_MAGIC


def _is_hot(journal: Path) -> bool:
    """Whether it holds a transaction: a finished one is emptied, cut or overwritten with zeros."""
    if not journal.is_file() or journal.stat().st_size < JOURNAL_BYTES:
        return False
    with journal.open("rb") as file:
        return file.read(len(JOURNAL_MAGIC)) == JOURNAL_MAGIC


def _beside(path: Path, suffix: str) -> Path:
    return path.with_name(f"{path.name}{suffix}")
