"""Sensor data in the nuScenes layout: tables, and a file for each datum.

    v1.0-trainval/<table>.json   samples/<CHANNEL>/n001-<UTC>__<CHANNEL>__<µs>.{jpg,pcd.bin,pcd}

**Conventions.** Every frame is a key frame, so there are no `sweeps/`. Pictures are as recorded: the devkit projects
with `camera_intrinsic` alone, so where a lens bends (`camera_distortion` of `calibrated_sensor` is not all zero) it
errs towards the corners, and so does whoever does not undistort first. There are no boxes: `instance` and
`sample_annotation` are empty, `category` names the classes of the voxels. Nothing here knows of labels. Memory holds
one frame.
"""

from collections.abc import Callable, Mapping
from pathlib import Path

from services.labeler.exports.nuscenes.clouds import lidar_bytes, radar_bytes
from services.labeler.exports.nuscenes.plan import NS_PER_US, NuscenesChannel, NuscenesPlan
from services.labeler.exports.nuscenes.rows import add_fixed_rows, add_rig_rows, pose_row
from services.labeler.exports.nuscenes.tables import SPLITS, VERSION, NuscenesTableWriter, write_splits, written_tables
from stone.errors import StoneError
from stone.sensors.samples import SampleSource


class SampleGoneError(StoneError):
    """A message that the frame table names is not in the recording."""

    code = "sample_gone"

    def __init__(self, channel: str, frame: int) -> None:
        super().__init__(f"frame {frame} takes a message of {channel} that the recording does not have")


def write_samples(samples: SampleSource, plan: NuscenesPlan, out: Path, written: Callable[[int], None]) -> None:
    """Write tables and samples of the plan's sequence; `written(index)` is called after each frame.

    Raises `SampleGoneError`, and what reading samples raises (BAG-*, MSG-*).
    """
    for channel in plan.channels:
        (out / "samples" / channel.name).mkdir(parents=True)
    with written_tables(out / VERSION) as tables:
        add_fixed_rows(tables)
        add_rig_rows(tables, plan)
        for index in range(len(plan.sequence.frames)):
            _write_frame(samples, plan, index, (out, tables))
            written(index)
    write_splits(out / VERSION / SPLITS, {"all": [plan.sequence.name]})


def sample_file(samples: SampleSource, channel: NuscenesChannel, place: int) -> tuple[bytes, tuple[int, int]]:
    """The file of the `place`-th datum of a channel, and a picture's size (width, height), (0, 0) of anything else.

    Raises `SampleGoneError`, and what reading samples raises (BAG-*, MSG-*).
    """
    index, size_px = int(channel.frames[place]), (0, 0)
    if channel.modality == "lidar":
        return lidar_bytes(samples.lidar(index)), size_px
    if channel.modality == "radar":
        scan = samples.radar(channel.name, index)
        content = b"" if scan is None else radar_bytes(scan)
    else:
        picture = samples.camera(channel.name, index)
        content = b"" if picture is None else picture.content
        size_px = (0, 0) if picture is None else (picture.width_px, picture.height_px)
    if not content:
        raise SampleGoneError(channel.name, index)
    return content, size_px


def _write_frame(
    samples: SampleSource, plan: NuscenesPlan, index: int, to: tuple[Path, Mapping[str, NuscenesTableWriter]]
) -> None:
    out, tables = to
    frames = plan.sequence.frames
    token = frames.tokens[index]
    tables["sample"].add(
        {
            "token": token,
            "timestamp": int(frames.stamps_ns[index]) // NS_PER_US,
            "prev": frames.tokens[index - 1] if index else "",
            "next": frames.tokens[index + 1] if index + 1 < len(frames) else "",
            "scene_token": plan.scene_token,
        }
    )
    for channel in plan.channels:
        place = channel.place(index)
        if place is not None:
            content, size_px = sample_file(samples, channel, place)
            (out / plan.filename(channel, place)).write_bytes(content)
            tables["ego_pose"].add(pose_row(plan, channel, place))
            tables["sample_data"].add(_datum_row(plan, channel, place, size_px))


def _datum_row(
    plan: NuscenesPlan, channel: NuscenesChannel, place: int, size_px: tuple[int, int]
) -> Mapping[str, object]:
    token = plan.datum_token(channel, place)
    return {
        "token": token,
        "sample_token": plan.sequence.frames.tokens[channel.frames[place]],
        "ego_pose_token": token,
        "calibrated_sensor_token": plan.calibrated_token(channel),
        "timestamp": int(channel.stamps_ns[place]) // NS_PER_US,
        "fileformat": "jpg" if channel.modality == "camera" else "pcd",
        "is_key_frame": True,
        "height": size_px[1],
        "width": size_px[0],
        "filename": plan.filename(channel, place),
        "prev": plan.datum_token(channel, place - 1),
        "next": plan.datum_token(channel, place + 1),
    }
