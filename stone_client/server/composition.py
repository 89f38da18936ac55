"""The composition of a server's dataset, as tables and as the server's figure."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from stone_client.api import Api
from stone_client.tables import DASH, plain_table, safe_text, show
from stone_files.atomic import atomic_file

WAYS = (
    ("split", "parts"),
    ("environment", "environments"),
    ("illumination", "illuminations"),
    ("region", "regions"),
)
COLUMNS = ("sequences", "frames", "min", "km", "T", "P", "N")


def read_statistics(api: Api, dataset: str | None) -> dict[str, Any]:
    """Return the statistics of a version, or of the labelled sequences visible to the caller."""
    return api.read("/statistics", **_query(dataset))


def save_figure(api: Api, dataset: str | None, path: Path) -> None:
    """Save the composition as a PNG; the file appears whole."""
    answer = api.send("GET", "/statistics/composition.png", params=_query(dataset))
    with atomic_file(path) as staging:
        staging.write_bytes(answer.content)


def show_statistics(record: Mapping[str, Any]) -> None:
    for word, key in WAYS:
        _show_way(word, [*record[key], {"key": "all", **record["total"]}])


def _show_way(word: str, rows: Sequence[Mapping[str, Any]]) -> None:
    table = plain_table(f"by {word}", word, *COLUMNS)
    for row in rows:
        ratios = row["class_ratios"]
        classes = [f"{100 * ratio:.1f} %" for ratio in ratios.values()] if ratios else [DASH] * 3
        distance = DASH if row["distance_m"] is None else f"{row['distance_m'] / 1000:.2f}"
        counts = (f"{row['sequences']:,}", f"{row['frames']:,}", f"{row['duration_s'] / 60:.1f}", distance)
        table.add_row(safe_text(row["key"]) or DASH, *counts, *classes)
    show(table)


def _query(dataset: str | None) -> dict[str, str | int]:
    return {} if dataset is None else {"dataset": dataset}
