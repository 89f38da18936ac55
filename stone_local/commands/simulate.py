"""`stone simulate`: a recording of a simulated robot, with the ground truth of its world."""

from pathlib import Path
from typing import Annotated, cast, get_args

import typer

from simulator.options import (
    FAULT_NAMES,
    LIDAR_HZ,
    MAX_CAMERA_WIDTH_PX,
    MAX_CHANNELS,
    MAX_COLUMNS,
    MAX_SECONDS,
    MIN_CAMERA_WIDTH_PX,
    CameraDetail,
    FaultName,
    SimulateOptions,
    Traffic,
)
from stone.splits.surroundings import ILLUMINATIONS
from stone_client.choices import one_of
from stone_client.progress import reported
from stone_client.streams import JsonOption, echo_json

DEFAULT = SimulateOptions()

OutputArgument = Annotated[Path, typer.Argument(metavar="OUT.mcap", dir_okay=False, help="Output recording.")]
SecondsOption = Annotated[float, typer.Option(min=0.2, max=MAX_SECONDS, help="Duration of the drive, seconds.")]
SeedOption = Annotated[
    int, typer.Option(min=0, max=2**31, help="Seed of the world and the noise; equal seeds give equal recordings.")
]
TruthOption = Annotated[
    Path | None, typer.Option("--truth", metavar="DIR", file_okay=False, help="Also write the exact terrain and poses.")
]
ChannelsOption = Annotated[int, typer.Option(min=2, max=MAX_CHANNELS, help="Number of LiDAR beams.")]
ColumnsOption = Annotated[int, typer.Option(min=12, max=MAX_COLUMNS, help="Number of firings per LiDAR revolution.")]
CamerasOption = Annotated[bool, typer.Option(help="Also render the six cameras; their images are most of the file.")]
CameraWidthOption = Annotated[
    int,
    typer.Option(
        metavar="PX",
        min=MIN_CAMERA_WIDTH_PX,
        max=MAX_CAMERA_WIDTH_PX,
        help="Image width; the height is 5/8 of the width.",
    ),
]
CameraDetailOption = Annotated[
    str,
    typer.Option(
        metavar="|".join(get_args(CameraDetail)),
        **one_of(lambda: get_args(CameraDetail)),
        help="Rays per image: coarse (80 × 50, enlarged), half (one per 2 × 2 pixels) or full (one per pixel).",
    ),
]
IlluminationOption = Annotated[
    str,
    typer.Option(
        metavar="WORD",
        help=f"Illumination of the camera images: {', '.join(ILLUMINATIONS)}.",
        **one_of(lambda: ILLUMINATIONS),
    ),
]
RangeNoiseOption = Annotated[
    bool,
    typer.Option("--range-noise", help="Realistic LiDAR ranges: dropouts at grazing angles, mixed pixels, rain."),
]
BesideTrackOption = Annotated[
    bool,
    typer.Option(
        "--beside-track",
        help="Add rocks and bushes near the robot's path, and tall grass on it.",
    ),
]
TrafficOption = Annotated[
    str,
    typer.Option(
        metavar="WHO",
        **one_of(lambda: get_args(Traffic)),
        help=f"Moving objects: {', '.join(get_args(Traffic))} (three walkers, two vehicles).",
    ),
]
LidarHzOption = Annotated[
    int,
    typer.Option(metavar="HZ", help=f"Sweeps per second: {', '.join(map(str, LIDAR_HZ))}.", **one_of(lambda: LIDAR_HZ)),
]
FaultOption = Annotated[
    list[str],
    typer.Option(
        "--fault",
        metavar="NAME",
        help=f"Fault to inject; repeatable: {', '.join(FAULT_NAMES)}.",
        **one_of(lambda: FAULT_NAMES),
    ),
]


def simulate(
    out: OutputArgument,
    seconds: SecondsOption = DEFAULT.seconds,
    seed: SeedOption = DEFAULT.seed,
    truth: TruthOption = None,
    channels: ChannelsOption = DEFAULT.channels,
    columns: ColumnsOption = DEFAULT.columns,
    cameras: CamerasOption = DEFAULT.cameras,
    camera_width: CameraWidthOption = DEFAULT.camera_width_px,
    camera_detail: CameraDetailOption = DEFAULT.camera_detail,
    illumination: IlluminationOption = DEFAULT.illumination,
    range_noise: RangeNoiseOption = DEFAULT.range_noise,
    beside_track: BesideTrackOption = DEFAULT.beside_track,
    traffic: TrafficOption = DEFAULT.traffic,
    lidar_hz: LidarHzOption = DEFAULT.lidar_hz,
    fault: FaultOption = [],  # noqa: B006
    as_json: JsonOption = False,
) -> None:
    """Write a ROS 2 bag of a full rig on synthetic off-road terrain, and with --truth the exact terrain and poses."""
    from simulator.pipeline import simulate as simulate_recording

    faults = cast(tuple[FaultName, ...], tuple(fault))
    options = SimulateOptions(
        seconds=seconds,
        seed=seed,
        channels=channels,
        columns=columns,
        cameras=cameras,
        camera_width_px=camera_width,
        camera_detail=cast(CameraDetail, camera_detail),
        illumination=illumination,
        range_noise=range_noise,
        beside_track=beside_track,
        traffic=cast(Traffic, traffic),
        lidar_hz=lidar_hz,
        faults=faults,
    )
    with reported() as progress:
        simulate_recording(out, options, truth, progress)
    if as_json:
        echo_json(
            {"output": str(out), "truth": None if truth is None else str(truth), "size_bytes": out.stat().st_size}
        )
    else:
        typer.echo(out)
