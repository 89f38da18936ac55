"""`stone label`: from a recording and a calibration to 3D traversability labels."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from client.inputs import BagArgument, WorkersOption, cores
from client.progress import reported
from client.streams import JsonOption, echo_findings, echo_json
from client.tables import class_table, show
from stone.findings import Finding


class Profile(StrEnum):
    """How height enters the labels: `paper` takes it to the letter, `local` above the ground nearby."""

    PAPER = "paper"
    LOCAL = "local"


CalibrationOption = Annotated[
    Path,
    typer.Option("--calibration", metavar="CAL.yaml", exists=True, dir_okay=False, help="Where the sensors sit."),
]
OutputOption = Annotated[
    Path, typer.Option("-o", "--output", metavar="DIR", help="New or empty, or an earlier label set to replace.")
]
ProfileOption = Annotated[Profile, typer.Option(help="Height as in the paper, or above the ground nearby.")]
OdometryOption = Annotated[
    str | None, typer.Option(metavar="TOPIC", help="The topic that gives the poses; else the best the bag has.")
]

LidarOption = Annotated[
    str | None, typer.Option(metavar="TOPIC", help="The topic of the LiDAR's clouds, where the bag has several.")
]


def label(
    bag: BagArgument,
    calibration: CalibrationOption,
    output: OutputOption,
    profile: ProfileOption = Profile.PAPER,
    odometry: OdometryOption = None,
    lidar: LidarOption = None,
    workers: WorkersOption = None,
    as_json: JsonOption = False,
) -> None:
    """Label every frame of a recording: free, traversable, potentially traversable or not, in 0.2 m voxels."""
    if odometry == "kiss-icp":
        raise typer.BadParameter("kiss-icp is not built in yet; the bag must hold poses", param_hint="--odometry")
    from client.sequences import open_sequence
    from services.ingest.pipeline import SynchroniseOptions
    from services.labeler.parameters import parameters_for
    from services.labeler.pipeline import LabelOptions
    from services.labeler.pipeline import label as label_sequence

    with reported() as progress:
        topics = SynchroniseOptions(odometry_topic=odometry, lidar_topic=lidar)
        sequence, sweeps = open_sequence(bag, calibration, bag.stem, topics)
        options = LabelOptions(parameters_for(profile.value), workers or cores())
        record = label_sequence(sequence, sweeps, output, options, progress).as_record()
    if as_json:
        echo_json(record)
    else:
        title = f"{record['frames']} frames labelled, {len(record['excluded'])} excluded"
        show(class_table(title, record["class_share_of_occupied"]))
        typer.echo(f"Labels: {output}\nPicture: {output / 'bev.png'}")
    echo_findings(Finding(**finding) for finding in record["findings"])
