"""`stone admin backup`: backups of the platform on this machine."""

from pathlib import Path
from typing import Annotated, Any

import typer

from stone_client.confirmation import PermanentAct, YesOption, require_confirmation
from stone_client.options import DataOption
from stone_client.platform_part import platform_module
from stone_client.streams import JsonOption, echo_json

FolderArgument = Annotated[Path, typer.Argument(metavar="FOLDER", file_okay=False, help="The folder of the backups.")]
BackupsArgument = Annotated[
    Path, typer.Argument(metavar="FOLDER", exists=True, file_okay=False, help="The folder of the backups.")
]
DAMAGED = 1


def take(folder: FolderArgument, data: DataOption = None, as_json: JsonOption = False) -> None:
    """Back up the database, store and uploads of a running or stopped platform; only new content is copied."""
    _echo(_backups().take(folder, data), as_json=as_json)


def listed(folder: BackupsArgument, as_json: JsonOption = False) -> None:
    """List the snapshots of a folder, the oldest first."""
    _echo(_backups().listed(folder), as_json=as_json)


def verify(folder: BackupsArgument, as_json: JsonOption = False) -> None:
    """Read all files in a folder of backups and compare them with their hashes."""
    _echo(_backups().verify(folder), as_json=as_json)


def prune(
    folder: BackupsArgument,
    keep: Annotated[int, typer.Option(metavar="N", min=1, help="Number of snapshots to keep, newest first.")],
    is_confirmed: YesOption = False,
    as_json: JsonOption = False,
) -> None:
    """Delete older snapshots, and content that no remaining snapshot uses."""
    act = PermanentAct(f"delete all but the newest {keep} snapshots of {folder}", "older states cannot be restored")
    require_confirmation(act, is_given=is_confirmed)
    _echo(_backups().prune(folder, keep), as_json=as_json)


def restore(
    folder: BackupsArgument,
    snapshot: Annotated[str, typer.Option(metavar="NAME", help="The snapshot.", show_default="the newest")] = "",
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Restore a snapshot onto an empty platform without running processes; any other platform is refused."""
    _echo(_backups().restore(folder, data, snapshot), as_json=as_json)


def _backups() -> Any:
    return platform_module("backup", "admin backup")


def _echo(outcome: Any, *, as_json: bool) -> None:
    """Print the outcome; damage goes to stderr, with exit code 1."""
    if as_json:
        echo_json({**outcome.record, "is_well": outcome.is_well})
    else:
        for line in outcome.lines:
            typer.echo(line, err=not outcome.is_well)
    if not outcome.is_well:
        raise typer.Exit(DAMAGED)
