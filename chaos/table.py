"""The table of results: a row per kind of kill, with its counts."""

from collections import Counter
from collections.abc import Iterable
from statistics import median

from rich.table import Table

from chaos.rounds import RoundSeries

COLUMNS = ("rounds", "hit work", "lost", "doubled", "differing", "recovered, median s", "max s", "undisturbed run s")


def table_of(played: Iterable[RoundSeries], seed: int, seconds: float) -> Table:
    """Return the table; its counts are violations, and recovery is the time from the kill to the end of the run."""
    table = Table(title=f"seed {seed}, {seconds / 60:.1f} minutes")
    table.add_column("kind")
    for column in COLUMNS:
        table.add_column(column, justify="right")
    for series in played:
        table.add_row(series.kind.title, *_figures(series))
    return table


def _figures(series: RoundSeries) -> list[str]:
    sorts = Counter(violation.sort for ended in series.rounds for violation in ended.violations)
    seconds = [ended.recovered_s for ended in series.rounds if ended.recovered_s is not None]
    hits = sum(ended.is_hit for ended in series.rounds)
    recovered = (f"{median(seconds):.1f}", f"{max(seconds):.1f}") if seconds else ("never", "never")
    counts = (len(series.rounds), hits, sorts["lost"], sorts["doubled"], sorts["differing"])
    return [*map(str, counts), *recovered, f"{series.undisturbed.run_s:.1f}"]
