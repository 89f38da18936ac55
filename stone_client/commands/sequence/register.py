"""`stone sequence register`: register recordings that a server reads in place."""

from typing import Annotated, Any

import typer

from stone_base.findings import Finding
from stone_client.options import CalibrationOption, ServerOption
from stone_client.progress import transferred
from stone_client.streams import JsonOption, echo_findings, echo_json, echo_notice

PlacesArgument = Annotated[
    list[str],
    typer.Argument(
        metavar="ROOT:PATH...",
        help="Recording on the server, such as nas:2026/run.mcap: a bag, or the folder of a split bag; several of one "
        "run.",
    ),
]
NameOption = Annotated[str | None, typer.Option(metavar="NAME", help="The sequence (default: the bag's own name).")]
PicturesOption = Annotated[
    bool, typer.Option("--with-pictures", help="Also read the images of an object in a bucket (for exports).")
]
ProcessOption = Annotated[bool, typer.Option("--process", help="Process it immediately and follow the run.")]


def register(
    places: PlacesArgument,
    calibration: CalibrationOption,
    name: NameOption = None,
    with_pictures: PicturesOption = False,
    process: ProcessOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Register the recordings of a run that the server reads in place; only their calibration is uploaded.

    ROOT is the administrator's name for a folder or bucket of the server. Do not change the files afterwards: the
    server refuses a recording that differs from the registered one.
    """
    from stone_client.connection import connected
    from stone_client.server.places import add_in_place, place_named
    from stone_client.server.run_watch import watch_run
    from stone_client.server.sequences import ensure_sequence, pin_calibration, start_run

    server_places = [place_named(text, with_pictures=with_pictures) for text in places]
    with connected(server) as api:
        sequence = ensure_sequence(api, name or server_places[0].called)
        kept = pin_calibration(api, sequence, calibration)
        recordings = []
        for server_place in server_places:
            with transferred() as progress:
                recordings.append(add_in_place(api, sequence, server_place, progress))
        record: dict[str, Any] = {"sequence": sequence["id"], "name": sequence["name"], "calibration": kept["id"]}
        record |= {"recordings": [{key: item[key] for key in ("id", "filename", "sha256")} for item in recordings]}
        if process:
            record["job"] = watch_run(api, start_run(api, sequence, {}))
    if as_json:
        echo_json(record)
    else:
        for server_place in server_places:
            typer.echo(f"{sequence['name']}: {api.url} reads {server_place} in place")
        following = f"download {sequence['name']} -o DIR" if process else f"process {sequence['name']} --wait"
        echo_notice(f"Next: stone sequence {following}")
    noticed = [*kept["findings"], *(finding for recording in recordings for finding in recording["findings"])]
    echo_findings(Finding(**finding) for finding in noticed)
