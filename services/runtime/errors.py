"""Errors of any service: existing outputs, an unavailable or full store, a newer database schema."""

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


class BrokenReferenceError(StoneError):
    """A revision left a row whose foreign key refers to nothing; the upgrade was undone."""

    code: ClassVar[str] = "schema_broken_reference"

    def __init__(self, table: str, row: str, parent: str) -> None:
        super().__init__(
            f"row {row} of table {table!r} refers to a row of {parent!r} that does not exist; nothing was changed"
        )
