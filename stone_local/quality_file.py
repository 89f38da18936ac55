"""The quality of a recording as a page on disk, for `stone inspect --html`."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from stone_client.tables import plain_table, safe_text
from stone_files.atomic import atomic_file

if TYPE_CHECKING:
    from stone_recordings.bags.bag import Bag
    from stone_recordings.report.inspection import Inspection
    from stone_recordings.report.quality.report import Quality

HtmlOption = Annotated[
    Path | None,
    typer.Option("--html", metavar="OUT.html", dir_okay=False, help="Also measure the quality and write it as a page."),
]


def write_quality_page(bag: "Bag", inspection: "Inspection", out: Path) -> "Quality":
    """Measure the open recording and write the page, whole or not at all. Raises what reading it raises."""
    from stone_recordings.report.previews.pictures import previews_of
    from stone_recordings.report.quality.page import quality_page
    from stone_recordings.report.quality.report import quality_of
    from stone_recordings.report.quality.sampling import SampledMessages

    sampled = SampledMessages(bag)
    quality = quality_of(bag, inspection, sampled)
    pictures = tuple(previews_of(bag, inspection, sampled))
    with atomic_file(out) as staging:
        staging.write_bytes(quality_page(bag.path.name, inspection, quality, pictures))
    return quality


def deduction_table(record: Mapping[str, Any]) -> Table:
    """Return the deductions from the score with their reasons (the `quality` of `stone inspect --html OUT.html
    --json`).
    """
    table = plain_table(f"quality {record['score']} of 100", "code", "points")
    table.add_column("why", overflow="fold")
    for deduction in record["deductions"]:
        table.add_row(safe_text(deduction["code"]), f"-{deduction['points']}", safe_text(deduction["message"]))
    return table
