"""The board of a phase: as the server's record, as a table for people, or as the file the server makes of it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rich.table import Table

from client.api import Api
from client.benchmarks import phase_path
from client.scores import RATIOS, interval, percent
from client.tables import DASH, plain_table, safe_text


@dataclass(frozen=True)
class BoardAsked:
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


def read_board(api: Api, asked: BoardAsked) -> dict[str, Any]:
    record: dict[str, Any] = api.read(asked.path, **asked.query())
    return record


def board_file(api: Api, asked: BoardAsked, form: str) -> bytes:
    """The board as csv, md, tex or parquet."""
    return api.send("GET", asked.path, params={**asked.query(), "format": form}).content


def board_table(record: Mapping[str, Any]) -> Table:
    """A line for each row; a rank that a paired test cannot part from others shows its range."""
    title = f"{record['benchmark']} / {record['phase']}: track {record['track']}, %"
    table = plain_table(title, "", "method", "team", "track", *RATIOS.values(), "95 % of mIoU", "submission")
    for column in table.columns[1:4]:
        column.justify = "left"
    for row in record["rows"]:
        team = "(anonymous)" if row["team"] is None and row["submission_id"] else row["team"] or DASH
        yours = " *" if row["is_yours"] else ""
        said = (safe_text(row["method"]), f"{safe_text(team)}{yours}", row["modality"])
        ratios = (percent(row["ratios"][key]) for key in RATIOS)
        told = (row["intervals"] or {}).get("miou")
        table.add_row(_rank(row), *said, *ratios, interval(told), row["submission_id"] or DASH)
    return table


def _rank(row: Mapping[str, Any]) -> str:
    if row["rank"] is None:
        return str(row["standing"])
    low, high = row["rank_interval"] or (row["rank"], row["rank"])
    return str(row["rank"]) if low == high else f"{row['rank']} ({low}–{high})"
