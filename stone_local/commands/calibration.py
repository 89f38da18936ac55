"""`stone calibration`: check, create and draw a calibration."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import Annotated, Any, Literal

import typer

from stone.errors import StoneError
from stone.findings import Finding
from stone_client.choices import in_folder
from stone_client.options import LidarOption, OdometryOption
from stone_client.refusals import REFUSED
from stone_client.streams import JsonOption, echo_findings, echo_json
from stone_local.topic_choices import (
    PosesFrameOption,
    PosesOption,
    TopicOption,
    TopicsOption,
    chosen_poses,
    chosen_topics,
)

FileArgument = Annotated[
    Path,
    typer.Argument(metavar="FILE", exists=True, readable=True, help="Calibration: file, folder, zip or recording."),
]
BagOption = Annotated[
    Path | None,
    typer.Option("--bag", metavar="BAG", exists=True, help="Recording of the same robot to check against."),
]
PictureOption = Annotated[
    Path | None,
    typer.Option(
        "-o", "--output", metavar="RIG.svg", dir_okay=False, callback=in_folder, help="Draw the rig, as .svg or .png."
    ),
]
PICTURES: dict[str, Literal["svg", "png"]] = {".svg": "svg", ".png": "png"}


def check(
    file: FileArgument,
    bag: BagOption = None,
    odometry: OdometryOption = None,
    lidar: LidarOption = None,
    topics: TopicsOption = None,
    topic: TopicOption = [],  # noqa: B006
    poses: PosesOption = None,
    poses_frame: PosesFrameOption = "",
    as_json: JsonOption = False,
) -> None:
    """Check a calibration: its format, sensor poses and findings.

    With --bag it also reports unmatched topics and sensors, whether the LiDAR's points fit the camera images, and the
    height and tilt of the ground. Exit code 1 if the calibration cannot be used for labels.
    """
    from services.ingest.pipeline import SynchroniseOptions
    from stone_client.progress import reported
    from stone_local.calibration_check import BagChoice, check_calibration_file

    profile = chosen_topics(topics, topic)
    with _refused_with_what_was_found(file, as_json), reported() as progress:
        options = SynchroniseOptions(odometry, lidar, topics=profile.topics, progress=progress)
        options = replace(options, poses=chosen_poses(poses, poses_frame, odometry), poses_frame=poses_frame)
        choice = None if bag is None else BagChoice(bag, profile, replace(options, is_hashed=False))
        result = check_calibration_file(file, choice)
    _say(file, result.as_record(), as_json)
    if not as_json:
        typer.echo(f"verdict: {'can' if result.is_usable else 'cannot'} be used for labels")
    echo_findings(result.findings)
    if not result.is_usable:
        raise typer.Exit(REFUSED)


def init(
    bag: Annotated[Path, typer.Argument(metavar="BAG", exists=True, readable=True, help="A recording of the robot.")],
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            metavar="ROBOT.yaml",
            dir_okay=False,
            callback=in_folder,
            help="New file for the calibration.",
        ),
    ],
    topics: TopicsOption = None,
    topic: TopicOption = [],  # noqa: B006
    as_json: JsonOption = False,
) -> None:
    """Write a calibration from the data of a recording, with FILL_IN for unknown values.

    Extrinsics come from /tf_static, lenses from CameraInfo. `stone calibration check` refuses the file until every
    FILL_IN is replaced. An existing file is not overwritten.
    """
    from stone_files.atomic import atomic_file
    from stone_files.errors import output_exists
    from stone_recordings.bags.bag import open_bag
    from stone_recordings.report.rig.template import calibration_template, template_name

    if output.exists():
        raise output_exists(output, "there already")
    with open_bag(bag) as opened:
        template = calibration_template(opened, template_name(output), chosen_topics(topics, topic))
    with atomic_file(output) as staging:
        if output.exists():
            raise output_exists(output, "there already")
        staging.write_text(template.text, "utf-8")
    if as_json:
        echo_json({"output": str(output), "missing": template.missing, "known": template.known})
        return
    typer.echo(f"Calibration: {output}")
    for key in template.missing:
        typer.echo(f"fill in: {key}")
    typer.echo(f"Then: stone calibration check {quote(str(output))} --bag {quote(str(bag))}")


def show_rig(file: FileArgument, output: PictureOption = None, as_json: JsonOption = False) -> None:
    """Show the sensor poses of a calibration and its missing parts; with -o draw the rig.

    The drawing shows the robot from above and from the right, its footprint, and the field of view of each sensor.
    """
    from stone_files.atomic import atomic_file
    from stone_local.calibration_check import check_calibration_file
    from stone_recordings.report.rig.figure import rig_figure
    from stone_recordings.report.rig.record import is_footprint_given

    if output is not None and output.suffix.lower() not in PICTURES:
        raise typer.BadParameter(f"{output.name!r} is neither .svg nor .png", param_hint="--output")
    with _refused_with_what_was_found(file, as_json):
        result = check_calibration_file(file)
    if output is not None:
        picture = PICTURES[output.suffix.lower()]
        with atomic_file(output) as staging:
            staging.write_bytes(rig_figure(result.read.calibration, is_footprint_given(result.read), picture))
    _say(file, result.as_record(), as_json)
    if output is not None and not as_json:
        typer.echo(f"Drawing: {output}")
    echo_findings(result.findings)


@contextmanager
def _refused_with_what_was_found(file: Path, as_json: bool) -> Iterator[None]:
    """Print the content of each file before the refusal of an incomplete calibration.

    Refusals of the recording are printed as by every command.
    """
    from stone_client.tables import show
    from stone_local.calibration_tables import file_table
    from stone_recordings.report.rig.record import files_found

    try:
        yield
    except StoneError as error:
        if not error.code.startswith("CAL-"):
            raise
        files = files_found(file)
        refusal = Finding(error.code, "error", "", str(error))
        if as_json:
            echo_json({"is_usable": False, "files": files, "findings": [refusal.as_record()]})
        elif files:
            show(file_table(files))
        echo_findings((refusal,))
        raise typer.Exit(REFUSED) from None


def _say(file: Path, record: Mapping[str, Any], as_json: bool) -> None:
    from stone_client.tables import show
    from stone_local.calibration_tables import channel_table, lens_table, notes, sensor_table

    if as_json:
        echo_json(record)
        return
    show(sensor_table(record, file.name))
    lenses = lens_table(record)
    if lenses is not None:
        show(lenses)
    if record["channels"] is not None:
        show(channel_table(record["channels"]))
    for line in notes(record):
        typer.echo(line)
