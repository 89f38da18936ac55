"""`stone export`: convert local labels to the formats of other tools."""

from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from stone_base.counts import counted
from stone_client.choices import one_of
from stone_client.progress import reported
from stone_client.streams import JsonOption, echo_json


def _formats() -> Iterable[str]:
    from services.labeler.exports.registry import EXPORTERS

    return EXPORTERS


FolderArgument = Annotated[
    Path, typer.Argument(metavar="DIR", exists=True, file_okay=False, help="Folder written by `stone label`.")
]
FormatOption = Annotated[
    str,
    typer.Option(
        "--format",
        metavar="FORMAT",
        help="nuscenes (release layout), inputs (the same without labels), kitti (SemanticKITTI voxels), mesh (PLY, "
        "GLB), mcap (Foxglove), rrd (Rerun), previews (films, pictures), playback (of the viewer).",
        **one_of(_formats),
    ),
]
OutputOption = Annotated[
    Path | None,
    typer.Option(
        "-o",
        "--output",
        metavar="OUT",
        help="New folder, or an export in this format to add the sequence to.",
        show_default="DIR-FORMAT",
    ),
]
BagOption = Annotated[
    Path | None, typer.Option("--bag", metavar="BAG", exists=True, help="Path of the recording, if it was moved.")
]


def export(
    directory: FolderArgument,
    format_name: FormatOption,
    output: OutputOption = None,
    bag: BagOption = None,
    as_json: JsonOption = False,
) -> None:
    """Export a labelled sequence; unchanged parts are not written again.

    Images and points are read from the recording, which must be the labelled one.
    """
    from services.labeler.exports.folder import ExportRequest
    from services.labeler.exports.folder import export as export_folder
    from services.labeler.exports.source import folder_source, read_report
    from stone_recordings.sync.samples import checked_samples

    out = output or directory.with_name(f"{directory.resolve().name}-{format_name}")
    request = ExportRequest(format_name, out, read_report(directory))
    with reported() as progress:
        outcome = export_folder(
            request,
            lambda: folder_source(directory, checked_samples, bag),
            lambda done, total: progress("export", done, total),
        )
    if as_json:
        echo_json({**asdict(outcome), "output": str(out)})
    else:
        beside = f", now {counted(len(outcome.sequences), 'sequence')}" if outcome.status == "added" else ""
        typer.echo(f"{outcome.status}: {outcome.sequence}, {counted(outcome.frames, 'frame')}{beside}\nExport: {out}")
