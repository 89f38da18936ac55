"""`stone baseline`: a submission by geometry alone, from exported data."""

from pathlib import Path
from typing import Annotated

import typer

from stone_client.options import ManifestOption, WorkersOption, cores
from stone_client.progress import reported
from stone_client.streams import JsonOption, echo_json, echo_notice

SourceArgument = Annotated[
    list[Path],
    typer.Argument(
        metavar="SOURCE...",
        exists=True,
        help="Folders of `stone export --format nuscenes` or `inputs`, downloaded tars, a folder of these, or a "
        "published ZIP.",
    ),
]
OutputOption = Annotated[
    Path, typer.Option("-o", "--output", metavar="SUB.zip", dir_okay=False, help="The submission.")
]

SweepsOption = Annotated[
    int,
    typer.Option(
        metavar="N", min=1, max=100, help="Number of sweeps for each frame: its own and the latest earlier sweeps."
    ),
]


def baseline(
    sources: SourceArgument,
    manifest: ManifestOption,
    output: OutputOption,
    sweeps: SweepsOption = 1,
    workers: WorkersOption = None,
    as_json: JsonOption = False,
) -> None:
    """Predict every frame of a manifest from its own LiDAR sweep, untrained: the baseline that every method should
    beat.

    The lowest point of each column is ground. Steep or uneven ground is non-traversable, the corridor ahead
    traversable. With --sweeps, earlier sweeps add ground points, and the track behind the robot is traversable.
    """
    from stone_client.baseline import BaselinePlan, write_baseline

    with reported() as progress:
        written = write_baseline(sources, BaselinePlan(manifest, output, workers or cores(), sweeps=sweeps), progress)
    if as_json:
        echo_json(written.as_record())
    else:
        typer.echo(f"{output}: {written.frames:,} frames, {written.size_bytes:,} bytes, sha256 {written.sha256}")
        echo_notice(f"Next: stone validate {output} --manifest {manifest}")
