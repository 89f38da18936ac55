"""`stone sequence process`: label a sequence on the server."""

from typing import Annotated, Any

import typer

from stone_client.clock_offsets import ClockOffsetOption, clock_offsets_body
from stone_client.options import (
    DEFAULT_PROFILE,
    GridOption,
    Ground,
    GroundOption,
    LidarOption,
    OdometryOption,
    ParameterOption,
    ProfileOption,
    SequenceArgument,
    ServerOption,
    chosen_parameters,
)
from stone_client.streams import JsonOption, echo_json, echo_notice

RecordingOption = Annotated[
    list[str],
    typer.Option("--recording", metavar="FILE", help="Use only this recording; repeatable."),
]
WaitOption = Annotated[bool, typer.Option("--wait/--no-wait", help="Follow the run until it has ended.")]


def process(
    sequence: SequenceArgument,
    profile: ProfileOption = DEFAULT_PROFILE,
    parameter: ParameterOption = [],  # noqa: B006
    odometry: OdometryOption = None,
    lidar: LidarOption = None,
    ground: GroundOption = Ground.GIVEN,
    grid: GridOption = None,
    recording: RecordingOption = [],  # noqa: B006
    clock_offset: ClockOffsetOption = [],  # noqa: B006
    wait: WaitOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Label every frame of a sequence; a repeated request reuses the same run.

    The run uses all recordings of the sequence on one clock. Unless recordings are named, it starts again automatically
    when a recording is added.
    """
    from stone_client.connection import connected
    from stone_client.server.run_watch import watch_run
    from stone_client.server.sequences import find_sequence, recordings_named, start_run
    from stone_files.grid_file import chosen_grid

    body: dict[str, Any] = {"profile": profile.value}
    body |= {"parameters": chosen_parameters(parameter)} if parameter else {}
    body |= {"odometry_topic": odometry} if odometry else {}
    body |= {"lidar_topic": lidar} if lidar else {}
    body |= {"ground": ground.value} if ground != Ground.GIVEN else {}
    body |= {"grid": chosen_grid(grid).as_record()} if grid else {}
    body |= clock_offsets_body(clock_offset)
    with connected(server) as api:
        item = find_sequence(api, sequence)
        body |= {"recording_ids": recordings_named(api, item, recording)} if recording else {}
        run = start_run(api, item, body)
        run = watch_run(api, run) if wait else run
    if as_json:
        echo_json(run)
    else:
        typer.echo(f"{run['kind']} {run['id']} {run['state']}")
        following = f"download {item['name']} -o DIR" if run["state"] == "succeeded" else f"watch {run['id']}"
        echo_notice(f"Next: stone sequence {following}")
