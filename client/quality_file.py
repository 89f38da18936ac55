"""The quality of a recording as a page on the disk, for `stone inspect --html`."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from client.tables import plain_table, safe_text
from services.runtime.atomic import atomic_file

if TYPE_CHECKING:
    from services.ingest.inspection import Inspection
    from services.ingest.quality.report import Quality

HtmlOption = Annotated[
    Path | None,
    typer.Option(
        "--html", metavar="OUT.html", dir_okay=False, help="Also measure its quality and write that as a page."
    ),
]


def write_quality_page(bag: Path, inspection: "Inspection", out: Path) -> "Quality":
    """Measure the recording at `bag` and write the page, whole or not at all. Raises what `open_bag` raises."""
    from services.ingest.bag import open_bag
    from services.ingest.previews.pictures import previews_of
    from services.ingest.quality.page import quality_page
    from services.ingest.quality.report import quality_of

    with open_bag(bag) as opened:
        quality = quality_of(opened, inspection)
        pictures = tuple(previews_of(opened, inspection))
    with atomic_file(out) as staging:
        staging.write_bytes(quality_page(bag.name, inspection, quality, pictures))
    return quality


def deduction_table(record: Mapping[str, Any]) -> Table:
    """What the score lost and by what (the `quality` of `stone inspect --html OUT.html --json`)."""
    table = plain_table(f"quality {record['score']} of 100", "code", "points")
    table.add_column("why", overflow="fold")
    for one in record["deductions"]:
        table.add_row(safe_text(one["code"]), f"-{one['points']}", safe_text(one["message"]))
    return table
