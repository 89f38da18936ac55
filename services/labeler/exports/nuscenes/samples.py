"""Sensor data in the nuScenes layout: tables, and a file for each datum.

    v1.0-trainval/<table>.json   samples/<CHANNEL>/n001-<UTC>__<CHANNEL>__<µs>.{jpg,pcd.bin,pcd}

**Conventions.** Every frame is a key frame, so there are no `sweeps/`. Pictures are as recorded. The devkit projects
with `camera_intrinsic` only, so its projections err towards the corners if a lens distorts (`camera_distortion` of
`calibrated_sensor` is not all zero). There are no boxes: `instance` and `sample_annotation` are empty, `category` lists
the voxel classes. This module has no access to labels. It holds one frame in memory.
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.labeler.exports.nuscenes.plan import NS_PER_US, NuscenesChannel, NuscenesPlan
from services.labeler.exports.nuscenes.tables import (
    SPLITS,
    VERSION,
    NuscenesTableWriter,
    Row,
    lines_of,
    token_of,
    write_splits,
    written_tables,
)
from stone.errors import Refused
from stone.sensors.calibration import CameraIntrinsics
from stone.sensors.samples import LidarSample, RadarSample, SampleSource


class SampleGoneError(Refused):
    """A frame uses a message that the recording lacks, or that cannot be read."""

    def __init__(self, index: int, channel: str) -> None:
        super().__init__(
            "sample_gone", f"frame {index} uses a message of {channel} that is not in the recording or cannot be read"
        )


def write_samples(samples: SampleSource, plan: NuscenesPlan, out: Path, written: Callable[[int], None]) -> None:
    """Write tables and samples of the plan's sequence; `written(index)` is called after each frame.

    Unreadable pictures and scans are left out. Raises what reading samples raises (BAG-*, MSG-* of sweeps).
    """
    for channel in plan.channels:
        (out / "samples" / channel.name).mkdir(parents=True)
    gone = dict[str, tuple[str, str]]()
    with written_tables(out / VERSION) as tables:
        add_fixed_rows(tables)
        add_rig_rows(tables, plan)
        for index in range(len(plan.sequence.frames)):
            gone |= _write_frame(samples, plan, index, (out, tables))
            written(index)
    if gone:
        _close_chains(out / VERSION / "sample_data.json", gone)
    write_splits(out / VERSION / SPLITS, {"all": [plan.sequence.name]})


def sample_file(samples: SampleSource, channel: NuscenesChannel, number: int) -> tuple[bytes, tuple[int, int]]:
    """Return the file of a channel's datum number `place`, and a picture's size (width, height), else (0, 0).

    Raises `sample_gone`, and what reading samples raises (BAG-*, MSG-*).
    """
    index, size_px = int(channel.frames[number]), (0, 0)
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
        raise SampleGoneError(index, channel.name)
    return content, size_px


def _write_frame(
    samples: SampleSource, plan: NuscenesPlan, index: int, to: tuple[Path, Mapping[str, NuscenesTableWriter]]
) -> dict[str, tuple[str, str]]:
    """Write a frame; return, by its token, the planned neighbours of each unreadable datum."""
    out, tables = to
    frames, gone = plan.sequence.frames, dict[str, tuple[str, str]]()
    token = frames.tokens[index]
    tables["sample"].add(
        {
            "token": token,
            "timestamp": int(frames.stamps_ns[index]) // NS_PER_US,
            "prev": frames.tokens[index - 1] if index and plan.is_ordered else "",
            "next": frames.tokens[index + 1] if index + 1 < len(frames) and plan.is_ordered else "",
            "scene_token": plan.scene_token,
        }
    )
    for channel in plan.channels:
        number = channel.place(index)
        if number is None:
            continue
        try:
            content, size_px = sample_file(samples, channel, number)
        except SampleGoneError:
            row = _datum_row(plan, channel, number, (0, 0))
            gone[str(row["token"])] = (str(row["prev"]), str(row["next"]))
            continue
        (out / plan.filename(channel, number)).write_bytes(content)
        tables["ego_pose"].add(pose_row(plan, channel, number))
        tables["sample_data"].add(_datum_row(plan, channel, number, size_px))
    return gone


def _close_chains(table: Path, gone: Mapping[str, tuple[str, str]]) -> None:
    """Link the neighbours of missing data to each other."""
    closed = table.with_suffix(".closed")
    with closed.open("w", encoding="utf-8") as file:
        rows = NuscenesTableWriter(file)
        for line in lines_of(table):
            row = json.loads(line)
            for side, name in enumerate(("prev", "next")):
                while row[name] in gone:
                    row[name] = gone[row[name]][side]
            rows.add(row)
        rows.end()
    closed.replace(table)


def _datum_row(
    plan: NuscenesPlan, channel: NuscenesChannel, number: int, size_px: tuple[int, int]
) -> Mapping[str, object]:
    token = plan.datum_token(channel, number)
    return {
        "token": token,
        "sample_token": plan.sequence.frames.tokens[channel.frames[number]],
        "ego_pose_token": token,
        "calibrated_sensor_token": plan.calibrated_token(channel),
        "timestamp": int(channel.stamps_ns[number]) // NS_PER_US,
        "fileformat": "jpg" if channel.modality == "camera" else "pcd",
        "is_key_frame": True,
        "height": size_px[1],
        "width": size_px[0],
        "filename": plan.filename(channel, number),
        "prev": plan.datum_token(channel, number - 1) if plan.is_ordered else "",
        "next": plan.datum_token(channel, number + 1) if plan.is_ordered else "",
    }


# Point clouds in nuScenes formats: LiDAR returns as bare floats, radar detections as binary PCD. Points are in the
# sensor's axes: a sweep at the frame's stamp, a radar scan at its measurement. Only finite rows are written. Source:
# `LidarPointCloud.from_file` and `RadarPointCloud.from_file` of nuscenes-devkit 1.2.


RADAR_RECORD = np.dtype(
    [
        ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("dyn_prop", "i1"), ("id", "<i2"), ("rcs", "<f4"), ("vx", "<f4"),
        ("vy", "<f4"), ("vx_comp", "<f4"), ("vy_comp", "<f4"), ("is_quality_valid", "i1"), ("ambig_state", "i1"),
        ("x_rms", "i1"), ("y_rms", "i1"), ("invalid_state", "i1"), ("pdh0", "i1"), ("vx_rms", "i1"), ("vy_rms", "i1"),
    ]
)  # fmt: skip
# Defaults for facts that detections lack, in the schema's terms: motion unknown, Doppler unambiguous, valid.
UNKNOWN_MOTION, UNAMBIGUOUS, VALID, QUALITY_VALID = 4, 3, 0, 1
LAST_ID = 32767


def lidar_bytes(sample: LidarSample) -> bytes:
    """Return `.pcd.bin`: x y z intensity ring, five float32 per return."""
    rows = np.empty((len(sample.points_lidar), 5), "<f4")
    rows[:, :3], rows[:, 3], rows[:, 4] = sample.points_lidar, sample.intensity, sample.ring
    return rows[np.isfinite(rows).all(axis=1)].tobytes()


def radar_bytes(sample: RadarSample) -> bytes:
    """Return `.pcd`: the 18 fields of nuScenes; velocities are the measured rate along the ray, in plan.

    A scan without a finite detection has one row of NaN, which the devkit reads as empty.
    """
    records = _records(sample)
    if not len(records):
        records = np.zeros(1, RADAR_RECORD)
        for name in ("x", "y", "z", "rcs", "vx", "vy", "vx_comp", "vy_comp"):
            records[name] = np.nan
    # The devkit's reader requires one byte after the last record.
    return _header(len(records)) + records.tobytes() + b"\n"


def _records(sample: RadarSample) -> NDArray[np.void]:
    is_finite = np.isfinite(sample.points_radar).all(axis=1) & (sample.points_radar != 0).any(axis=1)
    for measured in (sample.range_rate_m_s, sample.ground_rate_m_s, sample.rcs_db):
        is_finite &= np.isfinite(measured)
    points = sample.points_radar[is_finite]
    towards = points[:, :2] / np.linalg.norm(points, axis=1)[:, None]
    records = np.zeros(len(points), RADAR_RECORD)
    records["x"], records["y"], records["z"] = points.T
    records["vx"], records["vy"] = (towards * sample.range_rate_m_s[is_finite, None]).T
    records["vx_comp"], records["vy_comp"] = (towards * sample.ground_rate_m_s[is_finite, None]).T
    records["rcs"], records["id"] = sample.rcs_db[is_finite], np.minimum(np.arange(len(points)), LAST_ID)
    records["dyn_prop"], records["ambig_state"] = UNKNOWN_MOTION, UNAMBIGUOUS
    records["invalid_state"], records["is_quality_valid"] = VALID, QUALITY_VALID
    return records


def _header(count: int) -> bytes:
    names = RADAR_RECORD.names or ()
    kinds = [RADAR_RECORD[name] for name in names]
    lines = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS " + " ".join(names),
        "SIZE " + " ".join(str(kind.itemsize) for kind in kinds),
        "TYPE " + " ".join("F" if kind.kind == "f" else "I" for kind in kinds),
        "COUNT " + " ".join("1" for _ in names),
        f"WIDTH {count}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {count}",
        "DATA binary",
    ]
    return ("\n".join(lines) + "\n").encode()


# nuScenes table rows whose number does not depend on the data: classes, rig, log, map, scene. Facts without a place in
# the schema get additional keys, which the devkit ignores. Rotations are quaternions wxyz. Source: nuScenes schema.


CLASSES = (
    ("free", "a voxel without surface; mask_lidar marks observed voxels"),
    ("traversable", "the robot's footprint swept this surface"),
    (
        "potentially_traversable",
        "surface that resembles the traversable surface within the confidence of the reference",
    ),
    ("non_traversable", "all other surface"),
)
VISIBILITIES = ("v0-40", "v40-60", "v60-80", "v80-100")


def add_fixed_rows(tables: Mapping[str, NuscenesTableWriter]) -> None:
    """Add the rows that are the same in every export."""
    for index, (name, description) in enumerate(CLASSES):
        token = token_of("category", name)
        tables["category"].add({"token": token, "name": name, "description": description, "index": index})
    for number, level in enumerate(VISIBILITIES, 1):
        tables["visibility"].add({"token": str(number), "level": level, "description": f"visibility {level} %"})


def add_rig_rows(tables: Mapping[str, NuscenesTableWriter], plan: NuscenesPlan) -> None:
    """Add the sensors, their calibration, and the sequence's single log, map and scene."""
    for channel in plan.channels:
        sensor_token = token_of("sensor", channel.name)
        tables["sensor"].add({"token": sensor_token, "channel": channel.name, "modality": channel.modality})
        tables["calibrated_sensor"].add(_calibrated_row(plan, channel, sensor_token))
    tables["log"].add(_log_row(plan))
    map_row = {
        "category": "semantic_prior",
        "token": token_of("map", plan.sequence.name),
        "filename": plan.mask_filename,
        "log_tokens": [plan.log_token],
    }
    tables["map"].add(map_row)
    tables["scene"].add(_scene_row(plan))


def pose_row(plan: NuscenesPlan, channel: NuscenesChannel, number: int) -> Row:
    """Return the robot's pose when a datum was measured: `global_from_ego`."""
    pose = channel.map_from_ego[number]
    x, y, z = pose.translation_m.tolist()
    return {
        "token": plan.datum_token(channel, number),
        "timestamp": int(channel.stamps_ns[number]) // NS_PER_US,
        "rotation": pose.wxyz.tolist(),
        "translation": [x - plan.low_m[0], y - plan.low_m[1], z],
    }


def _calibrated_row(plan: NuscenesPlan, channel: NuscenesChannel, sensor_token: str) -> Row:
    ego_from_sensor = plan.sequence.calibration.ego_from_lidar @ channel.mount.lidar_from_sensor
    intrinsics = channel.mount.intrinsics
    row: dict[str, object] = {
        "token": plan.calibrated_token(channel),
        "sensor_token": sensor_token,
        "translation": ego_from_sensor.translation_m.tolist(),
        "rotation": ego_from_sensor.wxyz.tolist(),
        "camera_intrinsic": [] if intrinsics is None else _matrix(intrinsics),
    }
    if intrinsics is not None:
        row |= {"camera_model": intrinsics.model, "camera_distortion": list(intrinsics.distortion)}
    return row


def _matrix(intrinsics: CameraIntrinsics) -> list[list[float]]:
    return [
        [intrinsics.fx_px, 0.0, intrinsics.cx_px],
        [0.0, intrinsics.fy_px, intrinsics.cy_px],
        [0.0, 0.0, 1.0],
    ]


def _log_row(plan: NuscenesPlan) -> Row:
    origin = plan.sequence.map_origin_deg_m
    return {
        "token": plan.log_token,
        "logfile": plan.logfile,
        "vehicle": plan.sequence.calibration.name,
        "date_captured": plan.logfile[5:15],
        "location": "unknown" if origin is None else f"{origin[0]:.4f},{origin[1]:.4f}",
        "map_origin_deg_m": origin,
        "global_from_map_m": [-plan.low_m[0], -plan.low_m[1], 0],
        "pose_source": plan.sequence.pose_source,
    }


def _scene_row(plan: NuscenesPlan) -> Row:
    frames = plan.sequence.frames
    quality = {} if plan.quality is None else {"quality": plan.quality}
    return {
        "token": plan.scene_token,
        "log_token": plan.log_token,
        "nbr_samples": len(frames),
        "first_sample_token": frames.tokens[0],
        "last_sample_token": frames.tokens[-1],
        "name": plan.sequence.name,
        "description": f"{len(frames)} frames of {', '.join(sorted(plan.sequence.inputs))}",
        **quality,
    }
