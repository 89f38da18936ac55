"""`stone sequence exports`: a sequence's labels in common formats, created on the server."""

from typing import Annotated, Any

import typer

from stone_base.newer_python import StrEnum
from stone_client.options import SequenceArgument, ServerOption
from stone_client.progress import reported
from stone_client.streams import JsonOption, echo_json, echo_notice
from stone_client.tables import show


class Format(StrEnum):
    """The formats of exports: nuScenes devkit (inputs: without labels), SemanticKITTI tools, mesh viewers, Foxglove,
    Rerun, previews and the playback of the viewer.
    """

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
        item = find_sequence(api, sequence)
        if form is not None:
            with reported() as progress:
                make_export(api, item, form.value, progress)
        listed = exports_of(api, item)
    record: dict[str, Any] = {"sequence": item["name"], "exports": listed}
    if as_json:
        echo_json(record)
        return
    show(exports_table(item["name"], listed))
    if form is not None:
        echo_notice(
            f"Next: stone sequence download {item['name']} --format {form.value} -o {item['name']}-{form.value}.tar"
        )
