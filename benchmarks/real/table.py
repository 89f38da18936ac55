"""The figures of `benchmarks.real` as tables for a docs page: a row per profile and option."""

from collections.abc import Iterable, Mapping

from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks.real.held_out import KNOWN_RATIOS
from benchmarks.real.labelled_map import Figures

COLUMNS = (
    ("ground_down", "ground upside down", ".2%"),
    ("flat_down", "flat ground upside down", ".2%"),
    ("covered", "T under the track", ".1%"),
    ("flat_n", "N on flat ground", ".2%"),
    ("wall_n", "N on walls", ".1%"),
    ("ground_tp", "T ∪ P on ground", ".1%"),
    ("obstacle_n", "N on obstacles", ".1%"),
    ("unlabelled", "points unlabelled", ".1%"),
    ("p_share", "P of all voxels", ".1%"),
    ("held_out", "held-out recall", ".2%"),
    ("held_out_m", "of m", ".0f"),
    *((f"{side}_{ratio:g}", f"from {side} {ratio:.0%}", ".2%") for ratio in KNOWN_RATIOS for side in ("first", "last")),
    ("reference", "n", ".0f"),
    ("sigma_deg", "σ of slope, °", ".1f"),
    ("parity_differs", "even / odd differ", ".2%"),
    ("parity_n", "in N", ".2%"),
    ("halves_differs", "halves differ", ".2%"),
    ("halves_n", "in N", ".2%"),
)
CLASS_MARKS = ("T ∪ P of ", "N of ")


def show(title: str, rows: Mapping[tuple[str, str], Figures]) -> None:
    """Print the table of one recording, and one of its classes if points have some."""
    print(f"\n{title}\n")
    used = [column for column in COLUMNS if _is_known(rows, column[0])]
    table = _table(name for _, name, _ in used)
    for (profile, option), figures in rows.items():
        cells = [_cell(figures, key, form) for key, _, form in used]
        table.add_row(profile, option, *(cells if "refused" not in figures else [f"refused: {figures['refused']}"]))
    _print(table)
    _show_classes(rows)


def _show_classes(rows: Mapping[tuple[str, str], Figures]) -> None:
    names = dict.fromkeys(name for figures in rows.values() for name in figures if name.startswith(CLASS_MARKS))
    used = [name for name in names if _is_known(rows, name)]
    if not used:
        return
    table = _table(used)
    for how, figures in rows.items():
        if "refused" not in figures:
            table.add_row(*how, *(_cell(figures, name, ".1%") for name in used))
    print()
    _print(table)


def _is_known(rows: Mapping[tuple[str, str], Figures], key: str) -> bool:
    return any(figures.get(key) is not None for figures in rows.values())


def _table(columns: Iterable[str]) -> Table:
    table = Table("profile", "option", box=box.MARKDOWN)
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    return table


def _print(table: Table) -> None:
    Console(width=max(Console().width, 320)).print(table)


def _cell(figures: Figures, key: str, form: str) -> str:
    value = figures.get(key)
    return "" if value is None else format(value, form)
