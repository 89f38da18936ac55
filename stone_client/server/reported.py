"""The rows of a published table or a ceiling, added to a board as reported rows.

**Conventions.** Rows outside the table stay as they are. An equal existing row is kept. A differing existing row is an
error unless it is to be replaced, because its author may have corrected it.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from rich.table import Table

from stone_base.errors import Refused
from stone_client.api import Api
from stone_client.server.benchmarks import administered_phase
from stone_client.server.published_tables import PublishedTable
from stone_client.server.scores import RATIOS, percent
from stone_client.server.sequences import Item
from stone_client.tables import DASH, plain_table, safe_text

TEXTS = {"kind": "kind", "source": "source", "note": "note", "percent_digits": "number of decimals"}
DONE = {"put": "put", "left": "unchanged", "replaced": "replaced"}


def reported_differs(pairs: Iterable[tuple[Item, Item]]) -> Refused:
    differences = "; ".join(f"{_named(new)}: {_difference(old, new)}" for old, new in pairs)
    return Refused(
        "reported_differs",
        f"rows of these methods exist and differ from the published rows, so nothing was written: {differences}; "
        "check which rows are right, and add --replace to write the published rows",
    )


@dataclass(frozen=True)
class Putting:
    """The board, the reason, and whether differing rows are replaced."""

    benchmark: str
    phase: str
    reason: str
    replaces: bool = False


def put_table(api: Api, table: PublishedTable, how: Putting) -> dict[str, Any]:
    """Add the missing rows; return the outcome for each row. Raises `reported_differs`."""
    path = f"{administered_phase(api, how.benchmark, how.phase)}/reported"
    answer = api.send("GET", path)
    standing: dict[tuple[str, str], Item] = {_key(row): row for row in answer.json()["items"]}
    rows = table.reported()
    done = [_done(standing.get(_key(row)), row) for row in rows]
    differing = [(standing[_key(row)], row) for row, what in zip(rows, done, strict=True) if what == "replaced"]
    if differing and not how.replaces:
        raise reported_differs(differing)
    if set(done) != {"left"}:
        whole = standing | {_key(row): row for row in rows}
        body = {"rows": list(whole.values()), "reason": how.reason}
        api.send("PUT", path, json=body, headers={"If-Match": answer.headers["ETag"]})
    shown = [row | {"done": what} for row, what in zip(rows, done, strict=True)]
    return {"benchmark": how.benchmark, "phase": how.phase, "title": table.title, "source": table.source, "rows": shown}


def shown_table(record: Mapping[str, Any]) -> Table:
    """Return the table with the outcome for each row."""
    title = safe_text(f"{record['title']} on {record['benchmark']} / {record['phase']}: reported, not ranked, %")
    table = plain_table(title, "method", "track", *RATIOS.values(), "")
    for row in record["rows"]:
        values = (percent(row[name], row["percent_digits"]) for name in RATIOS)
        table.add_row(safe_text(row["method"]), row["modality"], *values, DONE[row["done"]])
    return table


def _done(standing: Item | None, row: Item) -> str:
    if standing is None:
        return "put"
    return "replaced" if any(standing[name] != value for name, value in row.items()) else "left"


def _key(row: Item) -> tuple[str, str]:
    return row["method"], row["modality"]


def _named(row: Item) -> str:
    return f"{row['method']} ({row['modality']})"


def _difference(old: Item, new: Item) -> str:
    numbers = [
        f"{name} is {_whole(old[key])}, in the table {percent(new[key], new['percent_digits'])}"
        for key, name in RATIOS.items()
        if old[key] != new[key]
    ]
    return ", ".join([*numbers, *(f"another {name}" for key, name in TEXTS.items() if old[key] != new[key])])


def _whole(ratio: float | None) -> str:
    """Return per cent with every digit of the ratio."""
    return DASH if ratio is None else f"{100 * ratio:.10g}"
