"""Errors of any service: existing outputs, an unavailable or full store, a newer or older database schema."""

from typing import ClassVar

from stone.errors import StoneError


class NewerSchemaError(StoneError):
    """The database was migrated by a newer version of the platform than this one."""

    code: ClassVar[str] = "schema_newer"

    def __init__(self, stands: str, known: str) -> None:
        super().__init__(
            f"the database is at revision {stands!r} and this version knows none after {known!r}; "
            "start the version that migrated it, or restore a backup"
        )


class OlderSchemaError(StoneError):
    """The database or the backup is of a revision from before the first release."""

    code: ClassVar[str] = "schema_older"
    last_commit: ClassVar[str] = "1c1f180f"

    def __init__(self, stands: str, known: str) -> None:
        super().__init__(
            f"the database or backup is of revision {stands!r} and this version upgrades from {known!r} on; restore "
            f"and start it once with the sources of commit {self.last_commit}, then start this version"
        )


class BrokenReferenceError(StoneError):
    """A revision left a row whose foreign key refers to nothing; the upgrade was undone."""

    code: ClassVar[str] = "schema_broken_reference"

    def __init__(self, table: str, row: str, parent: str) -> None:
        super().__init__(
            f"row {row} of table {table!r} refers to a row of {parent!r} that does not exist; nothing was changed"
        )
