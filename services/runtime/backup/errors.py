"""Errors of taking, restoring and verifying backups."""

from pathlib import Path

from stone.errors import PlatformFaultError, StoneError


class DamagedBackupError(StoneError):
    """The content of the backup differs from what was written."""

    code = "backup_damaged"

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path} {reason}; replace it from another copy of the backup, or restore an earlier snapshot")


class SourceDamagedError(PlatformFaultError):
    """The store's object differs from its row."""

    def __init__(self, name: str, actual: str, expected: str) -> None:
        super().__init__(
            "object_damaged", f"{name} has sha256 {actual}, but its row has {expected}; the store's disk may be failing"
        )
