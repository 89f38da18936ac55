"""`stone upload`: a recording and its calibration to a server."""

from typing import Annotated, Any

import typer

from stone_base.findings import Finding
from stone_client.options import BagArgument, CalibrationOption, ServerOption
from stone_client.progress import transferred
from stone_client.streams import JsonOption, echo_findings, echo_json

NameOption = Annotated[str | None, typer.Option(metavar="NAME", help="The sequence; else the bag's own name.")]
ProcessOption = Annotated[bool, typer.Option("--process", help="Have it processed at once, and watch.")]


def upload(
    bag: BagArgument,
    calibration: CalibrationOption,
    name: NameOption = None,
    process: ProcessOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Send a recording and its calibration; begun again after anything, it goes on where it was.

    A folder of a split bag is one recording: every file of the bag is sent, and then they are sealed together.
    """
    from stone_client.connection import connected
    from stone_client.files.bags import called, hashed_bag
    from stone_client.server.run_watch import watch_run
    from stone_client.server.sequences import add_recording, ensure_sequence, pin_calibration, start_run

    with connected(server) as api:
        sequence = ensure_sequence(api, name or called(bag))
        kept = pin_calibration(api, sequence, calibration)
        with transferred() as progress:
            recording = add_recording(api, sequence, hashed_bag(bag, progress), progress)
        record: dict[str, Any] = {"sequence": sequence["id"], "name": sequence["name"], "recording": recording["id"]}
        record |= {"calibration": kept["id"], "sha256": recording["sha256"]}
        if process:
            record["job"] = watch_run(api, start_run(api, sequence, {}))
    if as_json:
        echo_json(record)
    else:
        typer.echo(f"{sequence['name']}: {recording['filename']} is on {api.url}")
        _say_next(sequence["name"], is_processed=process)
    echo_findings(Finding(**finding) for finding in (*kept["findings"], *recording["findings"]))


def _say_next(name: str, *, is_processed: bool) -> None:
    following = f"stone download {name} -o DIR" if is_processed else f"stone process {name} --watch"
    typer.echo(f"Next: {following}")
