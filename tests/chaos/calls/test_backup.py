"""If any system call of a backup fails, the old snapshots remain, perhaps with a new one; the next backup is whole."""

from pathlib import Path

from services.runtime.backup.capture import make_backup
from services.runtime.backup.folder import SNAPSHOTS, STAGING, BackupFolder
from services.runtime.backup.retention import verify
from services.runtime.platform import Platform
from services.runtime.settings import Settings
from testing.failing_calls import Disturbed, Fault
from testing.servers.fixtures import opened
from tests.chaos.calls.every_call import FAULTS, each_call
from tests.services.runtime.backup.laid import add_blob, lay

BACKUPS = "backups"


def folder_of(platform: Platform) -> BackupFolder:
    return BackupFolder(platform.settings.root.parent / BACKUPS)


def back_up(platform: Platform) -> None:
    """Make the second backup: the first one exists, with most of the objects that the second one names."""
    make_backup(platform, folder_of(platform))


@FAULTS
def test_a_backup_is_there_or_not_and_never_half(settings: Settings, fault: Fault, step: int, tmp_path: Path) -> None:
    platform = opened(settings, [])
    laid = lay(platform, tmp_path / "scratch")
    make_backup(platform, BackupFolder(tmp_path / BACKUPS))
    add_blob(platform, laid.owner, tmp_path / "scratch", b"what came since the first backup")
    platform.database.close()

    def check(platform: Platform, disturbed: Disturbed) -> None:
        folder = folder_of(platform)
        before = len(folder.snapshots())
        assert before in (1, 2)
        if not disturbed.raised and not disturbed.was_killed:
            assert before == 2, f"said to be made, {disturbed.hit}"
        assert verify(folder).damaged == ()
        back_up(platform)
        assert len(folder.snapshots()) == before + 1
        verified = verify(folder)
        assert (verified.damaged, verified.snapshots) == ((), before + 1)
        assert not list((folder.root / STAGING).iterdir())
        assert sorted(path.name for path in (folder.root / SNAPSHOTS).iterdir()) == folder.snapshots()

    assert each_call(settings, back_up, check, fault, step) > 50
