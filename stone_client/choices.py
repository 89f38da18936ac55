"""Checks of option values: wrong usage (exit code 2) is refused before anything is read or sent."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import typer

from stone_base.label_grid import GRIDS

Value = TypeVar("Value")


def one_of(names: Callable[[], Iterable[object]], *, is_file_too: bool = False) -> dict[str, Any]:
    """Return the arguments of an option whose values are these names; with `is_file_too` also paths of files.

    `names` is a function, so that nothing is imported before the option is used.
    """

    def checked(value: Value) -> Value:
        given = value if isinstance(value, list | tuple) else [value]
        for item in given:
            if item is not None and item not in names() and not (is_file_too and Path(str(item)).is_file()):
                known = ", ".join(map(str, names()))
                raise typer.BadParameter(
                    f"{str(item)[:80]!r} is not one of {known}{' or a file' if is_file_too else ''}"
                )
        return value

    def completed(incomplete: str) -> list[str]:
        return [str(name) for name in names() if str(name).startswith(incomplete)]

    return {"callback": checked, "autocompletion": completed}


def refuse_options(why: str, given: Mapping[str, object]) -> None:
    """Refuse the first of these options that was given, as it would have no effect. Raises `typer.BadParameter`."""
    for option, value in given.items():
        if value:
            raise typer.BadParameter(why, param_hint=option)


def in_folder(file: Path | None) -> Path | None:
    """Return the path of a file to write. Raises `typer.BadParameter` if its folder does not exist."""
    if file is not None and not file.absolute().parent.is_dir():
        raise typer.BadParameter(f"the folder {str(file.parent)!r} does not exist; create it, or correct the path")
    return file


def layouts() -> Iterable[str]:
    """Return the names of the layouts of published datasets."""
    from stone_files.dataset_layouts import LAYOUTS

    return LAYOUTS


def grids() -> Iterable[str]:
    """Return the names of the platform's grids."""
    return GRIDS
