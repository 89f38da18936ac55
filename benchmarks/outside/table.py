"""The figures of `benchmarks.outside` as Markdown tables: a row per LiDAR, fault and profile, over all worlds.

**Conventions.** Ratios are of the counts of all worlds; "worst" is the ratio of the worst world, "worst kind" the
greatest danger of a kind in one world. Shares of kinds and slope bands are of labelled voxels that are T or P; missed
is relative to sightings, which include every voxel.
"""

from collections import Counter
from collections.abc import Mapping, Sequence

from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks.outside.rows import Outcome, added
from testing.outside.verdict import Figures

Key = tuple[str, str, str]  # channels, fault, profile
AXES = (
    ("iou", "IoU", ".3f", min),
    ("danger", "danger", ".1%", max),
    ("lost", "lost", ".1%", max),
    ("missed", "missed", ".1%", max),
    ("salt", "salt a frame", ".0f", max),
)
KINDS = ("trunk", "bush", "wall", "bar", "post", "rock", "person", "ditch", "bank", "mound", "hill")
BANDS = ("0-10°", "10-15°", "15-20°", "20-25°", "25-35°", "35-90°")


def show(rows: Mapping[Key, Sequence[Outcome]]) -> None:
    """Print the tables."""
    main = _table(
        *(name for axis in AXES for name in (axis[1], "worst")), "worst kind", "walker T ∪ P", "findings", "refused"
    )
    danger = _table(*(f"{kind}" for kind in KINDS))
    missed = _table(*(f"{kind}" for kind in KINDS))
    bands = _table(*BANDS)
    for key, outcomes in rows.items():
        labelled = [outcome for outcome in outcomes if not outcome.refused]
        main.add_row(*key, *_cells(labelled), *_codes(outcomes))
        figures = added(labelled).figures()
        danger.add_row(*key, *(_cell(figures, f"danger {kind}", ".1%") for kind in KINDS))
        missed.add_row(*key, *(_cell(figures, f"missed {kind}", ".1%") for kind in KINDS))
        bands.add_row(*key, *(_cell(figures, f"steep {band}", ".1%") for band in BANDS))
    console = Console(width=max(Console().width, 280))
    for title, table in (
        ("Labels against analytic worlds", main),
        ("Danger: T ∪ P of an obstacle's voxels, by kind", danger),
        ("Missed: sightings with T ∪ P only, by kind", missed),
        ("T ∪ P of open ground, by slope", bands),
    ):
        console.print(f"\n{title}\n")
        console.print(table)


def _cells(labelled: Sequence[Outcome]) -> list[str]:
    if not labelled:
        return [""] * (2 * len(AXES) + 2)
    together, each, cells = (
        added(labelled).figures(),
        [outcome.verdict().figures() for outcome in labelled],
        list[str](),
    )
    for key, _, form, worst in AXES:
        values = [value for value in (figures[key] for figures in each) if value is not None]
        cells += [_cell(together, key, form), format(worst(values), form) if values else ""]
    kinds = [(figures[key], key) for figures in each for key in figures if key.startswith("danger ")]
    share, kind = max((share or 0.0, key.removeprefix("danger ")) for share, key in kinds)
    named = f"{kind} {share:.0%}"
    return [*cells, named, _cell(together, "walker_tp", ".0f")]


def _codes(outcomes: Sequence[Outcome]) -> tuple[str, str]:
    """Return the findings, with the number of worlds of each, and likewise the refusals."""
    findings = Counter(code for outcome in outcomes for code in outcome.findings)
    refused = Counter(outcome.refused for outcome in outcomes if outcome.refused)
    codes, refusals = (
        " ".join(f"{code}×{n}" for code, n in sorted(outcome.items())) for outcome in (findings, refused)
    )
    return codes, refusals


def _table(*columns: str) -> Table:
    table = Table("channels", "fault", "profile", box=box.MARKDOWN)
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    return table


def _cell(figures: Figures, key: str, form: str) -> str:
    value = figures.get(key)
    return "" if value is None else format(value, form)
