"""`stone process`: label a sequence on the server."""

from typing import Annotated, Any

import typer

from stone_client.options import (
    Ground,
    GroundOption,
    LabelProfile,
    LidarOption,
    OdometryOption,
    ProfileOption,
    SequenceArgument,
    ServerOption,
)
from stone_client.streams import JsonOption, echo_json

WatchOption = Annotated[bool, typer.Option("--watch", help="Stay until it has ended.")]


def process(
    sequence: SequenceArgument,
    profile: ProfileOption = LabelProfile.PAPER,
    odometry: OdometryOption = None,
    lidar: LidarOption = None,
    ground: GroundOption = Ground.GIVEN,
    watch: WatchOption = False,
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Have every frame of a sequence labelled; asked twice, it is done once."""
    from stone_client.connection import connected
    from stone_client.server.run_watch import watch_run
    from stone_client.server.sequences import find_sequence, start_run

    body: dict[str, Any] = {"profile": profile.value}
    body |= {"odometry_topic": odometry} if odometry else {}
    body |= {"lidar_topic": lidar} if lidar else {}
    body |= {"ground": ground.value} if ground != Ground.GIVEN else {}
    with connected(server) as api:
        found = find_sequence(api, sequence)
        run = start_run(api, found, body)
        run = watch_run(api, run) if watch else run
    if as_json:
        echo_json(run)
    else:
        typer.echo(f"{run['kind']} {run['id']} {run['state']}")
        following = f"download {found['name']} -o DIR" if run["state"] == "succeeded" else f"watch {run['id']}"
        typer.echo(f"Next: stone {following}")
