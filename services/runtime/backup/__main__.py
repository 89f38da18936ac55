"""`python -m services.runtime.backup to|restore|verify|list|prune FOLDER`: docs/operations/backup.md.

**Conventions.** Which platform is meant is said by `STONE_*`, as to every process. Ends with 0 when all is well, 1 when
something is refused, damaged or lost (sentences on stderr), 2 when it was asked for what there is not.
"""

import argparse
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TextIO

import services.runtime.processes.sound_settings  # noqa: F401
from services.runtime.backup.capture import BackupResult, make_backup
from services.runtime.backup.folder import BackupFolder
from services.runtime.backup.restore import BackupRestoreResult, restore
from services.runtime.backup.retention import BackupPruneResult, BackupVerification, prune, verify
from services.runtime.backup.snapshot import read_snapshot
from services.runtime.embedded.listen_socket import hold_folder
from services.runtime.platform import Platform, open_silent_platform
from services.runtime.processes.private_files import keep_private
from services.runtime.settings import Settings
from stone.errors import StoneError

# isort: split


def main(arguments: list[str] | None = None) -> int:
    options = _options(arguments)
    folder = BackupFolder(options.folder.absolute())
    try:
        said, is_well = _acted(options, folder)
    except StoneError as error:
        _say([f"{error.code}: {error}"], sys.stderr)
        return 1
    _say(said, sys.stdout if is_well else sys.stderr)
    return 0 if is_well else 1


def _acted(options: argparse.Namespace, folder: BackupFolder) -> tuple[list[str], bool]:
    """The command's output lines, and whether all is well."""
    if options.act == "verify":
        verified = verify(folder)
        return of_verified(verified), not verified.damaged
    if options.act == "list":
        return of_list(folder), True
    if options.act == "prune":
        return of_pruned(prune(folder, options.keep)), True
    if options.act == "to":
        with _opened() as platform:
            taken = make_backup(platform, folder)
        return of_backup(taken), not taken.snapshot.flaws
    with ExitStack() as stack:
        stack.enter_context(hold_folder(Settings().root))  # no embedded platform begins meanwhile
        restored = restore(stack.enter_context(_opened()), folder, options.snapshot)
        return of_restored(restored), not restored.snapshot.flaws


@contextmanager
def _opened() -> Iterator[Platform]:
    platform = open_silent_platform(Settings())
    try:
        yield platform
    finally:
        platform.database.close()


def _say(said: list[str], stream: TextIO) -> None:
    stream.writelines(f"{line}\n" for line in said)


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m services.runtime.backup", description=__doc__)
    acts = parser.add_subparsers(dest="act", required=True)
    for name, purpose in (
        ("to", "take a backup of the platform into FOLDER"),
        ("restore", "bring a backup back onto an empty platform"),
        ("verify", "read all of FOLDER and compare"),
        ("list", "say which snapshots there are"),
        ("prune", "let old snapshots go"),
    ):
        act = acts.add_parser(name, help=purpose, description=purpose)
        act.add_argument("folder", type=Path, metavar="FOLDER")
        if name == "restore":
            act.add_argument("--snapshot", default="", help="the newest unless named")
        if name == "prune":
            act.add_argument("--keep", type=_positive, required=True, help="how many of the newest stay")
    return parser.parse_args(arguments)


def _positive(word: str) -> int:
    number = int(word)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{word} is not at least 1")
    return number


if __name__ == "__main__":
    keep_private()
    sys.exit(main())


# Messages of the backup command to the administrator.


MIB = 2**20


def of_backup(taken: BackupResult) -> list[str]:
    rows, snapshot = sum(table.rows for table in taken.snapshot.tables), taken.snapshot
    return [
        f"backed up {rows} rows and {taken.blobs} blobs, of which {taken.brought} files "
        f"({taken.brought_bytes / MIB:.1f} MiB) were new: {taken.folder.name}",
        *(f"DAMAGED on the platform itself: {flaw}" for flaw in snapshot.flaws),
    ]


def of_restored(restored: BackupRestoreResult) -> list[str]:
    said = [
        f"restored {restored.rows} rows, {restored.objects - restored.flawed} objects and {restored.uploads} uploads "
        f"under way; {restored.queued_again} jobs that were running are queued again"
    ]
    if restored.flawed:
        said.append(f"LOST before the backup was taken: {restored.flawed} objects")
    return [*said, *(f"LOST: {flaw}" for flaw in restored.snapshot.flaws)]


def of_verified(verified: BackupVerification) -> list[str]:
    return [
        f"read {verified.contents} contents ({verified.size_bytes / MIB:.1f} MiB) of {verified.snapshots} snapshots",
        *(f"DAMAGED: {sentence}" for sentence in verified.damaged),
    ]


def of_pruned(pruned: BackupPruneResult) -> list[str]:
    return [f"{pruned.snapshots} snapshots and {pruned.contents} contents ({pruned.size_bytes / MIB:.1f} MiB) are gone"]


def of_list(folder: BackupFolder) -> list[str]:
    said = []
    for name in folder.snapshots():
        snapshot, _files = read_snapshot(folder.snapshot(name))
        rows = sum(table.rows for table in snapshot.tables)
        said.append(f"{name}  revision {snapshot.revision}  {rows} rows  {len(snapshot.flaws)} flaws")
    return said
