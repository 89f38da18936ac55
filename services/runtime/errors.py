"""What any service may run into: outputs in the way, a store that is away or full, a database of another version."""

from pathlib import Path
from typing import ClassVar

from stone.errors import StoneError


class PlatformFaultError(StoneError):
    """Not the input is at fault but the machine, for now: a job that meets one of these is tried again."""


class OutputExistsError(StoneError):
    """Something that is not ours to replace stands where the output should go."""

    code: ClassVar[str] = "output_exists"

    def __init__(self, path: Path, found: str) -> None:
        super().__init__(f"{path} is {found}; choose another output path, or remove it first")


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
