"""`frames.parquet`: one row per LiDAR stamp, usable or not.

**Columns.** frame_token (null if excluded), stamp_ns, map_from_ego as x_m y_m z_m qw qx qy qz, exclusion_code and
exclusion_reason (null if usable), voxels by class, observed voxels. For the pose: rtk_status (unknown none single
differential float fixed), pose_gap_ns between the two poses around the stamp, and east_stdev_m north_stdev_m up_stdev_m
(null if unknown). Per sensor, the LiDAR as `LIDAR`: `<channel>_topic`, `<channel>_index` (message number in the order
of recording, −1 none) and `<channel>_dt_ns` (signed). Per IMU: `<channel>_start` and `<channel>_stop`, its samples
until the next frame, counted in the order of their stamps.

**Metadata.** Under `stone`, JSON: sequence, vehicle (the calibration's name), recordings and calibration (name →
sha256), pose_source, map_origin_deg_m and the learnt trigger phase of each camera, ns.
"""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from services.labeler.frames import FrameVoxelCounts
from stone.sensors.sequence import Frames, Sequence

POSE_COLUMNS = ("qw", "qx", "qy", "qz", "x_m", "y_m", "z_m")
STDEV_COLUMNS = ("east_stdev_m", "north_stdev_m", "up_stdev_m")
CLASS_COLUMNS = ("free_voxels", "t_voxels", "p_voxels", "n_voxels")


def write_frames(path: Path, sequence: Sequence, counts: FrameVoxelCounts) -> None:
    """Write the frame table in stamp order."""
    usable = _usable(sequence, counts)
    excluded = pa.table(
        {
            "stamp_ns": pa.array([frame.stamp_ns for frame in sequence.excluded], pa.int64()),
            "exclusion_code": pa.array([frame.code for frame in sequence.excluded], pa.string()),
            "exclusion_reason": pa.array([frame.reason for frame in sequence.excluded], pa.string()),
        }
    )
    table = pa.concat_tables([usable, excluded], promote_options="default").sort_by("stamp_ns")
    table = table.replace_schema_metadata({"stone": json.dumps(_about(sequence), sort_keys=True)})
    pq.write_table(table, path, compression="zstd")


def _usable(sequence: Sequence, counts: FrameVoxelCounts) -> pa.Table:
    frames = sequence.frames
    columns: dict[str, object] = {"frame_token": list(frames.tokens), "stamp_ns": frames.stamps_ns}
    columns |= dict(zip(POSE_COLUMNS, frames.map_from_ego.wxyz_xyz.T, strict=True))
    columns |= {name: counts.classes[:, c] for c, name in enumerate(CLASS_COLUMNS)}
    columns |= {"mask_lidar_voxels": counts.observed[:, 0], "mask_camera_voxels": counts.observed[:, 1]}
    columns |= _quality(frames)
    lidar = {"LIDAR": frames.sweeps} if frames.sweeps is not None else {}
    for channel, taken in (lidar | dict(frames.associations)).items():
        columns[f"{channel}_topic"] = pa.repeat(taken.topic, len(frames)).dictionary_encode()
        columns |= {f"{channel}_index": taken.message_index, f"{channel}_dt_ns": taken.dt_ns}
    for channel, between in frames.slices.items():
        columns |= {f"{channel}_start": between.start[:-1], f"{channel}_stop": between.start[1:]}
    empty = pa.nulls(len(frames), pa.string())
    return pa.table({**columns, "exclusion_code": empty, "exclusion_reason": empty})


def _quality(frames: Frames) -> dict[str, object]:
    """Return the quality of the poses; nothing if the frames were not made from a recording."""
    if frames.quality is None:
        return {}
    stdev_m = frames.quality.stdev_m
    columns: dict[str, object] = {"rtk_status": frames.quality.rtk_words(), "pose_gap_ns": frames.quality.gap_ns}
    for axis, name in enumerate(STDEV_COLUMNS):
        columns[name] = pa.array(stdev_m[:, axis], pa.float64(), from_pandas=True)  # NaN is null
    return columns


def _about(sequence: Sequence) -> dict[str, object]:
    taken = sequence.frames.associations.items()
    return {
        "sequence": sequence.name,
        "vehicle": sequence.calibration.name,
        "inputs": dict(sequence.inputs),
        "pose_source": sequence.pose_source,
        "map_origin_deg_m": sequence.map_origin_deg_m,
        "phase_ns": {
            channel: association.phase_ns for channel, association in taken if association.phase_ns is not None
        },
    }


def concatenated(parts: list[FrameVoxelCounts]) -> FrameVoxelCounts:
    """Return the counts of all parts, in frame order."""
    columns = zip(*((part.classes, part.observed, part.filled) for part in parts), strict=True)
    return FrameVoxelCounts(*map(np.concatenate, columns))
