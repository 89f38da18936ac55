"""The board of a phase: the server's record, a table for people, or the server's file."""

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
    """The selection of a board: its track, its time (empty: now), the best of each team or all entries."""

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


def read_board(api: Api, selection: BoardSelection) -> dict[str, Any]:
    return api.read(selection.path, **selection.query())


def board_file(api: Api, selection: BoardSelection, form: str) -> bytes:
    """Return the board as csv, md, tex or parquet."""
    return api.send("GET", selection.path, params={**selection.query(), "format": form}).content


def board_table(record: Mapping[str, Any]) -> Table:
    """Return two lines per row: method, team and submission; mIoU with its interval and the other scores.

    Danger is the share of N predicted T or P, and below it the share predicted T. A rank that a paired test cannot
    separate from others shows its range.
    """
    title = f"{record['benchmark']} / {record['phase']}: track {record['track']}, %"
    table = plain_table(title, "", "method · team", "track", *RATIOS.values(), "danger")
    for column in table.columns[1:3]:
        column.justify, column.overflow = "left", "fold"
    for row in record["rows"]:
        bounds = (row["intervals"] or {}).get("miou")
        miou, *others = (percent(row["ratios"][key], row["percent_digits"]) for key in RATIOS)
        whose = f"{safe_text(row['method'])}{_team(row)}\n{safe_text(row['submission_id'] or row['source'] or '')}"
        shares = (f"{miou}\n{interval(bounds) if bounds else ''}", *others, _danger(row))
        table.add_row(_rank(row), whose, row["modality"], *shares)
    return table


def reported_notes(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return the notes of reported rows, one line per note with the names of its rows."""
    names_of: dict[str, list[str]] = {}
    for row in rows:
        if row["note"]:
            names_of.setdefault(row["note"], []).append(f"{row['method']} ({row['modality']})")
    return [one_line(f"{', '.join(names)}: {note}") for note, names in names_of.items()]


def _team(row: Mapping[str, Any]) -> str:
    """Return the team's name, with an asterisk for the caller's own team."""
    if row["submission_id"] is None:
        return ""
    return f" · {'(anonymous)' if row['team'] is None else safe_text(row['team'])}{' *' if row['is_yours'] else ''}"


def _danger(row: Mapping[str, Any]) -> str:
    danger = row["danger"]
    if danger is None:
        return DASH
    return f"{percent(danger['n_predicted_drivable_ratio'])}\nT {percent(danger['n_predicted_t_ratio'])}"


def _rank(row: Mapping[str, Any]) -> str:
    if row["rank"] is None:
        return str(row["standing"])
    low, high = row["rank_interval"] or (row["rank"], row["rank"])
    return str(row["rank"]) if low == high else f"{row['rank']} ({low}–{high})"
