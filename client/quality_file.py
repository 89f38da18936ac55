"""The quality of a recording as a page on the disk, for `stone inspect --html`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

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
