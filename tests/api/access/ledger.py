"""Everything that is kept, as it stands at a moment: all rows of all tables, all files of the data folder.

**Conventions.** When a token was last used is left out, and wrong guesses of a password: both change by looking.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from hashlib import sha256

from sqlalchemy import select

from services.runtime.orm import Base
from services.runtime.platform import Platform

UNCOUNTED = {"used_ns"}
UNCOUNTED_TABLE = "sign_in_guesses"
Key = tuple[str, ...]


@dataclass(frozen=True)
class Ledger:
    """Rows by table and primary key, and files by name: each as text."""

    entries: Mapping[Key, str]

    def lost_or_changed(self, later: "Ledger") -> list[Key]:
        """What stood here and does not stand so any more."""
        return [key for key, text in self.entries.items() if later.entries.get(key) != text]

    def added_about(self, later: "Ledger", ids: frozenset[str]) -> list[Key]:
        """What came later and names one of `ids`."""
        fresh = {key: text for key, text in later.entries.items() if key not in self.entries}
        return [key for key, text in fresh.items() if any(one in text or one in key for one in ids)]


def ledger_of(platform: Platform) -> Ledger:
    """All that is kept now."""
    return Ledger(dict(_rows(platform)) | dict(_files(platform)))


def _rows(platform: Platform) -> Iterator[tuple[Key, str]]:
    with platform.database.reading() as session:
        for table in (table for table in Base.metadata.sorted_tables if table.name != UNCOUNTED_TABLE):
            keys = [column.name for column in table.primary_key]
            for row in session.execute(select(table)).mappings():
                shown = {name: value for name, value in row.items() if name not in UNCOUNTED}
                yield (table.name, *(str(row[key]) for key in keys)), repr(shown)


def _files(platform: Platform) -> Iterator[tuple[Key, str]]:
    for folder in ("uploads", "store"):
        for path in sorted((platform.settings.root / folder).rglob("*")):
            if path.is_file():
                yield ("file", str(path.relative_to(platform.settings.root))), sha256(path.read_bytes()).hexdigest()
