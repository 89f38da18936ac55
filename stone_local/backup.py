"""Backups of the platform on this machine, for `stone admin backup`."""

from pathlib import Path

from services.runtime.backup import acts
from services.runtime.backup.acts import BackupOutcome
from services.runtime.backup.folder import BackupFolder
from services.runtime.processes.private_files import keep_private
from services.runtime.settings import Settings


def take(folder: Path, data: Path | None) -> BackupOutcome:
    """Back up the platform of the environment, or of the data folder."""
    keep_private()
    return acts.take_backup(_settings(data), _folder(folder))


def restore(folder: Path, data: Path | None, snapshot: str) -> BackupOutcome:
    """Restore a snapshot (empty: the newest) onto the empty platform of the environment, or of the data folder."""
    keep_private()
    return acts.restore_backup(_settings(data), _folder(folder), snapshot)


def listed(folder: Path) -> BackupOutcome:
    return acts.list_backups(_folder(folder))


def verify(folder: Path) -> BackupOutcome:
    return acts.verify_backups(_folder(folder))


def prune(folder: Path, keep: int) -> BackupOutcome:
    keep_private()
    return acts.prune_backups(_folder(folder), keep)


def _folder(folder: Path) -> BackupFolder:
    return BackupFolder(folder.absolute())


def _settings(data: Path | None) -> Settings:
    settings = Settings()
    return settings if data is None else settings.model_copy(update={"data_folder": data})
