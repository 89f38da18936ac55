"""Errors of taking, restoring and verifying backups."""

from pathlib import Path

from stone.errors import PlatformFaultError, StoneError


class SchemaNotCurrentError(StoneError):
    """The database is not at the revision whose rows this code knows."""

    code = "schema_not_current"

    def __init__(self, stands: str, known: str) -> None:
        super().__init__(
            f"the database is at revision {stands!r}, this version is of {known!r}; back up with the version that "
            "serves it, or migrate first"
        )


class BackupBusyError(StoneError):
    """Another process works in the backup folder."""

    code = "backup_busy"

    def __init__(self, folder: Path) -> None:
        super().__init__(f"another backup is at work in {folder}; wait for it, or choose another folder")


class SnapshotMissingError(StoneError):
    """The folder holds no such snapshot, or none at all."""

    code = "snapshot_missing"

    def __init__(self, folder: Path, name: str, found: list[str]) -> None:
        wanted = f"snapshot {name!r}" if name else "snapshot"
        super().__init__(f"{folder} holds no {wanted}; there: {', '.join(found[-5:]) or 'none'}")


class DamagedBackupError(StoneError):
    """What lies in the backup is not what was put there."""

    code = "backup_damaged"

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path} {reason}; take it from another copy of the backup, or restore an earlier snapshot")


class TargetNotEmptyError(StoneError):
    """There is something where the backup would be restored to."""

    code = "target_not_empty"

    def __init__(self, place: str, found: str) -> None:
        super().__init__(f"{place} holds {found}; a backup is restored onto an empty platform only")


class SourceDamagedError(PlatformFaultError):
    """The store's object is not what its row says."""

    def __init__(self, name: str, found: str, expected: str) -> None:
        super().__init__(
            "object_damaged", f"{name} has sha256 {found}, its row says {expected}; the store's disk may be failing"
        )
