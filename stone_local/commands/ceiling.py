"""`stone ceiling`: label a drive twice from half of its points, and score one half against the other."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from stone_client.options import (
    BagArgument,
    CalibrationOption,
    Ground,
    GroundOption,
    LabelProfile,
    LidarOption,
    OdometryOption,
    ProfileOption,
    WorkersOption,
    cores,
)
from stone_client.progress import reported
from stone_client.streams import JsonOption, echo_json, echo_notice
from stone_client.tables import confusion_table, score_table, show
from stone_files.recording_name import sequence_name


class Half(StrEnum):
    """The halves of a drive: every other sweep, or every other ring of each sweep."""

    SWEEPS = "sweeps"
    RINGS = "rings"


class MaskName(StrEnum):
    """The evaluated voxels: all of them, or those seen by the LiDAR or by a camera."""

    ALL = "all"
    LIDAR = "lidar"
    CAMERA = "camera"


ByOption = Annotated[Half, typer.Option(help="How to halve the drive: even and odd sweeps, or even and odd rings.")]
MaskOption = Annotated[MaskName, typer.Option(help="Voxels to evaluate, as in the benchmark's phase.")]
OutputOption = Annotated[Path, typer.Option("-o", "--output", metavar="DIR", file_okay=False, help="Output folder.")]


def ceiling(
    bag: BagArgument,
    calibration: CalibrationOption,
    output: OutputOption,
    by: ByOption = Half.SWEEPS,
    mask: MaskOption = MaskName.ALL,
    profile: ProfileOption = LabelProfile.PAPER,
    odometry: OdometryOption = None,
    lidar: LidarOption = None,
    ground: GroundOption = Ground.GIVEN,
    workers: WorkersOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure the consistency of labels: label a drive from each half of its points, and compare both.

    No method is expected to score higher than this ceiling. `stone benchmark reported` adds the result to a board.
    """
    from services.ingest.pipeline import SynchroniseOptions
    from services.ingest.sequence import OpenedSequence, with_sequence
    from services.labeler.parameters import parameters_for
    from services.labeler.process_pool import begin_loading
    from stone_local.ceiling import ROW_FILE, CeilingPlan
    from stone_local.ceiling import ceiling as ceiling_of

    begin_loading()
    plan = CeilingPlan(output, by.value, mask.value, parameters_for(profile.value), workers or cores())
    with reported() as progress:
        output.mkdir(parents=True, exist_ok=True)
        sources = SynchroniseOptions(odometry, lidar, ground=ground.value, progress=progress)

        def measured(opened: OpenedSequence) -> dict[str, Any]:
            return ceiling_of(opened, plan, progress)

        record = with_sequence(bag, calibration, sequence_name(bag), sources, measured)
    if as_json:
        echo_json(record)
        return
    show(score_table(record, f"{record['frames']} frames, odd {by.value} against even ones"))
    show(confusion_table(record["confusion"], f"even {by.value}", f"odd {by.value}"))
    echo_notice(f"Next: stone benchmark reported {output / ROW_FILE} --benchmark BENCHMARK --phase PHASE")
