"""The folder of a run: which row it trains, said once, so that a resumed run trains the same."""

import json
from pathlib import Path

from baselines.checkpoint import CHECKPOINT
from baselines.errors import BadRunError, RunExistsError
from baselines.row_config import RowConfig, row_of
from stone_files.atomic import atomic_file

ROW_FILE = "row.json"


def opened_run(folder: Path, row: RowConfig, resume: bool) -> tuple[RowConfig, bool]:
    """The row that the run trains, and whether it has a checkpoint to go on from; nothing is written yet.

    A run that was killed before its first checkpoint begins again. Raises `RunExistsError` where one is there and is
    not to be resumed, `BadRunError` where it trains another row.
    """
    named = folder / ROW_FILE
    if not named.exists():
        if resume:
            raise BadRunError(folder, f"there is no {ROW_FILE}, so there is no run to resume; leave out --resume")
        return row, False
    if not resume:
        raise RunExistsError(folder)
    begun = read_run_row(folder)
    if begun.as_json() != row.as_json():
        raise BadRunError(folder, f"it trains {differences(begun, row)}; resume it with the same row and options")
    return begun, (folder / CHECKPOINT).exists()


def say_row(folder: Path, row: RowConfig) -> None:
    """Make the folder a run of this row."""
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_file(folder / ROW_FILE) as staging:
        staging.write_text(row.as_json() + "\n", "utf-8")


def read_run_row(folder: Path) -> RowConfig:
    """The row of a run. Raises `BadRunError`, `BadRowError`."""
    try:
        said = json.loads((folder / ROW_FILE).read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise BadRunError(folder, f"it is not a run of `stone train`: {ROW_FILE} cannot be read") from error
    return row_of(str(folder), said)


def differences(one: RowConfig, other: RowConfig) -> str:
    """Where two rows differ, in words."""
    a, b = _flat(json.loads(one.as_json())), _flat(json.loads(other.as_json()))
    parts = [f"{key} {a.get(key)}, not {b.get(key)}" for key in sorted(a.keys() | b.keys()) if a.get(key) != b.get(key)]
    return "; ".join(parts[:3])


def _flat(value: object, path: str = "") -> dict[str, object]:
    if not isinstance(value, dict):
        return {path: value}
    found = dict[str, object]()
    for key, part in value.items():
        found |= _flat(part, f"{path}.{key}" if path else str(key))
    return found
