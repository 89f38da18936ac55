"""Lists of a server's records as tables: a column for each field, ids whole."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.box import SIMPLE
from rich.table import Table

from stone_client.streams import echo_json
from stone_client.tables import DASH, safe_text, show

ID_CHARACTERS = 32
TO_SECONDS = len("2026-05-03T09:12:44")


def echo_records(key: str, records: Sequence[Mapping[str, Any]], columns: Mapping[str, str], *, as_json: bool) -> None:
    """Print the records under `key` as JSON, or as a table; `columns` maps a heading to a field."""
    if as_json:
        echo_json({key: list(records)})
        return
    table = Table(title=f"{key}: {len(records)}", title_justify="left", box=SIMPLE)
    for heading, field in columns.items():
        is_id = field == "id" or field.endswith("_id")
        is_whole = is_id or field.endswith("_at")
        table.add_column(heading, no_wrap=is_whole, overflow="ignore" if is_whole else "fold", min_width=_width(field))
    for record in records:
        table.add_row(*(_cell(field, record.get(field)) for field in columns.values()))
    show(table)


def items_of(answer: Any) -> list[dict[str, Any]]:
    """Return the records of a bare list, or of a page."""
    return list(answer["items"] if isinstance(answer, dict) else answer)


def _width(field: str) -> int | None:
    if field == "id" or field.endswith("_id"):
        return ID_CHARACTERS
    return TO_SECONDS if field.endswith("_at") else None


def _cell(field: str, value: Any) -> str:
    if value is None or value == "":
        return DASH
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list):
        return safe_text(", ".join(map(str, value))) or DASH
    if isinstance(value, dict):
        return safe_text(", ".join(f"{name} {part}" for name, part in value.items())) or DASH
    return safe_text(str(value)[:TO_SECONDS] if field.endswith("_at") else str(value))
