"""`stone sequence upload`: upload recordings and their calibration to a server."""

from typing import Annotated, Any

import typer

from stone_base.findings import Finding
from stone_client.choices import refuse_options
from stone_client.clock_offsets import ClockOffsetOption, clock_offsets_body
from stone_client.options import CalibrationOption, RunArgument, ServerOption
from stone_client.progress import transferred
from stone_client.streams import JsonOption, echo_findings, echo_json, echo_notice

NameOption = Annotated[str | None, typer.Option(metavar="NAME", help="The sequence (default: the bag's own name).")]
ProcessOption = Annotated[bool, typer.Option("--process", help="Process it immediately and follow the run.")]


def upload(
    bags: RunArgument,
    calibration: CalibrationOption,
    name: NameOption = None,
    process: ProcessOption = False,
    clock_offset: ClockOffsetOption = [],  # noqa: B006
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Upload the recordings of a run and its calibration. If the command is run again, it resumes.

    A folder of a split bag is one recording, and so are consecutively numbered files (run_0.mcap run_1.mcap). Other
    files (such as LiDAR and cameras) are separate recordings of one sequence; processing uses all of them.
    """
    from stone_client.connection import connected
    from stone_client.files.bags import bags_among, hashed_parts
    from stone_client.server.run_watch import watch_run
    from stone_client.server.sequences import add_recording, ensure_sequence, pin_calibration, start_run

    if not process:
        refuse_options(
            "it requires --process; or give it to `stone sequence process`", {"--clock-offset": clock_offset}
        )
    recorded_bags, choices = bags_among(bags), clock_offsets_body(clock_offset)
    with connected(server) as api:
        sequence = ensure_sequence(api, name or recorded_bags[0].called)
        kept = pin_calibration(api, sequence, calibration)
        recordings = []
        for bag in recorded_bags:
            with transferred() as progress:
                recordings.append(add_recording(api, sequence, hashed_parts(bag, progress), progress))
        record: dict[str, Any] = {"sequence": sequence["id"], "name": sequence["name"], "calibration": kept["id"]}
        record |= {"recordings": [{key: item[key] for key in ("id", "filename", "sha256")} for item in recordings]}
        record |= {"recording": recordings[0]["id"], "sha256": recordings[0]["sha256"]}
        if process:
            record["job"] = watch_run(api, start_run(api, sequence, choices))
    if as_json:
        echo_json(record)
    else:
        for recording in recordings:
            parts = f" ({len(recording['files'])} files of one bag)" if len(recording["files"]) > 1 else ""
            typer.echo(f"{sequence['name']}: {recording['filename']}{parts} is on {api.url}")
        if len(recordings) > 1:
            typer.echo(f"{len(recordings)} recordings of one run: processing uses all of them on a common clock.")
        _say_next(sequence["name"], is_processed=process)
    noticed = [*kept["findings"], *(finding for recording in recordings for finding in recording["findings"])]
    echo_findings(Finding(**finding) for finding in noticed)


def _say_next(name: str, *, is_processed: bool) -> None:
    following = f"stone sequence download {name} -o DIR" if is_processed else f"stone sequence process {name} --wait"
    echo_notice(f"Next: {following}")
