"""`stone sequence exports`: a sequence's labels in the formats that others open, made on the server."""

from typing import Annotated, Any

import typer

from stone_base.newer_python import StrEnum
from stone_client.options import SequenceArgument, ServerOption
from stone_client.progress import reported
from stone_client.streams import JsonOption, echo_json, echo_notice
from stone_client.tables import show


class Format(StrEnum):
    """What an export is opened with: the nuScenes devkit (inputs: without labels), SemanticKITTI tools, mesh viewers,
    Foxglove, Rerun, eyes, the viewer."""

    NUSCENES = "nuscenes"
    INPUTS = "inputs"
    KITTI = "kitti"
    MESH = "mesh"
    MCAP = "mcap"
    RRD = "rrd"
    PREVIEWS = "previews"
    PLAYBACK = "playback"


FormatOption = Annotated[Format | None, typer.Option("--format", help="Create this export and wait for it.")]


def exports(
    sequence: SequenceArgument, form: FormatOption = None, server: ServerOption = None, as_json: JsonOption = False
) -> None:
    """List the exports of a sequence, or create one; an existing one is reused."""
    from stone_client.connection import connected
    from stone_client.server.exports import exports_of, exports_table, make_export
    from stone_client.server.sequences import find_sequence

    with connected(server) as api:
        found = find_sequence(api, sequence)
        if form is not None:
            with reported() as progress:
                make_export(api, found, form.value, progress)
        listed = exports_of(api, found)
    record: dict[str, Any] = {"sequence": found["name"], "exports": listed}
    if as_json:
        echo_json(record)
        return
    show(exports_table(found["name"], listed))
    if form is not None:
        echo_notice(
            f"Next: stone sequence download {found['name']} --format {form.value} -o {found['name']}-{form.value}.tar"
        )
