"""The board of a phase: as the server's record, as a table for people, or as the file the server makes of it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from rich.table import Table

from stone_base.errors import one_line
from stone_client.api import Api
from stone_client.server.benchmarks import phase_path
from stone_client.server.scores import RATIOS, interval, percent
from stone_client.tables import DASH, plain_table, safe_text


@dataclass(frozen=True)
class BoardSelection:
    """Which board: of which track, at which time (empty: now), the best of each team or all entries."""

    benchmark: str
    phase: str
    track: str = "all"
    as_of: str = ""
    entries: str = "best"

    @property
    def path(self) -> str:
        return f"{phase_path(self.benchmark, self.phase)}/leaderboard"

    def query(self) -> dict[str, str]:
        return {"track": self.track, "entries": self.entries, **({"as_of": self.as_of} if self.as_of else {})}


def read_board(api: Api, asked: BoardSelection) -> dict[str, Any]:
    return api.read(asked.path, **asked.query())


def board_file(api: Api, asked: BoardSelection, form: str) -> bytes:
    """The board as csv, md, tex or parquet."""
    return api.send("GET", asked.path, params={**asked.query(), "format": form}).content


def board_table(record: Mapping[str, Any]) -> Table:
    """Two lines for each row: who and which submission, what it scored and the interval of its mIoU.

    Danger is the share of N predicted T or P, and below it that of T alone.
    A rank that a paired test cannot part from others shows its range.
    """
    title = f"{record['benchmark']} / {record['phase']}: track {record['track']}, %"
    table = plain_table(title, "", "method · team", "track", *RATIOS.values(), "danger")
    for column in table.columns[1:3]:
        column.justify, column.overflow = "left", "fold"
    for row in record["rows"]:
        told = (row["intervals"] or {}).get("miou")
        miou, *others = (percent(row["ratios"][key], row["percent_digits"]) for key in RATIOS)
        whose = f"{safe_text(row['method'])}{_team(row)}\n{safe_text(row['submission_id'] or row['source'] or '')}"
        shares = (f"{miou}\n{interval(told) if told else ''}", *others, _danger(row))
        table.add_row(_rank(row), whose, row["modality"], *shares)
    return table


def reported_notes(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """What is to be known of reported rows, in a line each that names them."""
    said: dict[str, list[str]] = {}
    for row in rows:
        if row["note"]:
            said.setdefault(row["note"], []).append(f"{row['method']} ({row['modality']})")
    return [one_line(f"{', '.join(names)}: {note}") for note, names in said.items()]


def _team(row: Mapping[str, Any]) -> str:
    """An asterisk marks one's own; nobody's name is nobody's."""
    if row["submission_id"] is None:
        return ""
    return f" · {'(anonymous)' if row['team'] is None else safe_text(row['team'])}{' *' if row['is_yours'] else ''}"


def _danger(row: Mapping[str, Any]) -> str:
    found = row["danger"]
    if found is None:
        return DASH
    return f"{percent(found['n_predicted_drivable_ratio'])}\nT {percent(found['n_predicted_t_ratio'])}"


def _rank(row: Mapping[str, Any]) -> str:
    if row["rank"] is None:
        return str(row["standing"])
    low, high = row["rank_interval"] or (row["rank"], row["rank"])
    return str(row["rank"]) if low == high else f"{row['rank']} ({low}–{high})"
