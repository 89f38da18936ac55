"""`python -m services.runtime.backup to|restore|verify|list|prune FOLDER`: docs/operations/backup.md.

**Conventions.** `STONE_*` settings select the platform, as for every process. The exit code is 0 on success, 1 if
something is refused, damaged or lost (messages on stderr), 2 for a usage error.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO

import services.runtime.processes.sound_settings  # noqa: F401
from services.runtime.backup.acts import (
    BackupOutcome,
    list_backups,
    prune_backups,
    restore_backup,
    take_backup,
    verify_backups,
)
from services.runtime.backup.folder import BackupFolder
from services.runtime.processes.private_files import keep_private
from services.runtime.settings import Settings
from stone.errors import StoneError

# isort: split


def main(arguments: list[str] | None = None) -> int:
    options = _options(arguments)
    folder = BackupFolder(options.folder.absolute())
    try:
        outcome = _acted(options, folder)
    except StoneError as error:
        _print([f"{error.code}: {error}"], sys.stderr)
        return 1
    _print(outcome.lines, sys.stdout if outcome.is_well else sys.stderr)
    return 0 if outcome.is_well else 1


def _acted(options: argparse.Namespace, folder: BackupFolder) -> BackupOutcome:
    if options.act == "verify":
        return verify_backups(folder)
    if options.act == "list":
        return list_backups(folder)
    if options.act == "prune":
        return prune_backups(folder, options.keep)
    if options.act == "to":
        return take_backup(Settings(), folder)
    return restore_backup(Settings(), folder, options.snapshot)


def _print(lines: Sequence[str], stream: TextIO) -> None:
    stream.writelines(f"{line}\n" for line in lines)


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m services.runtime.backup", description=__doc__)
    acts = parser.add_subparsers(dest="act", required=True)
    for name, purpose in (
        ("to", "Back up the platform into FOLDER"),
        ("restore", "Restore a backup onto an empty platform"),
        ("verify", "Read all of FOLDER and compare it with its checksums"),
        ("list", "List the snapshots"),
        ("prune", "Delete old snapshots"),
    ):
        act = acts.add_parser(name, help=purpose, description=purpose)
        act.add_argument("folder", type=Path, metavar="FOLDER")
        if name == "restore":
            act.add_argument("--snapshot", default="", help="Snapshot to restore (default: the newest)")
        if name == "prune":
            act.add_argument("--keep", type=_positive, required=True, help="Number of newest snapshots to keep")
    return parser.parse_args(arguments)


def _positive(word: str) -> int:
    number = int(word)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{word} is less than 1")
    return number


if __name__ == "__main__":
    keep_private()
    sys.exit(main())
