"""`frames.parquet`: one row per LiDAR stamp, usable or not.

**Columns.** frame_token (null when excluded), stamp_ns, map_from_ego as x_m y_m z_m qw qx qy qz, exclusion_code
and exclusion_reason (null when usable), voxels by class, voxels observed, and per sensor `<channel>_index` (message of
its topic, −1 none) and `<channel>_dt_ns` (signed).
"""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from services.labeler.frames import FrameCounts
from stone.sequence import Sequence

POSE_COLUMNS = ("qw", "qx", "qy", "qz", "x_m", "y_m", "z_m")
CLASS_COLUMNS = ("free_voxels", "t_voxels", "p_voxels", "n_voxels")


def write_frames(path: Path, sequence: Sequence, counts: FrameCounts) -> None:
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
    pq.write_table(table, path, compression="zstd")


def _usable(sequence: Sequence, counts: FrameCounts) -> pa.Table:
    frames = sequence.frames
    columns: dict[str, object] = {"frame_token": list(frames.tokens), "stamp_ns": frames.stamps_ns}
    columns |= dict(zip(POSE_COLUMNS, frames.map_from_ego.wxyz_xyz.T, strict=True))
    columns |= {name: counts.classes[:, c] for c, name in enumerate(CLASS_COLUMNS)}
    columns |= {"mask_lidar_voxels": counts.observed[:, 0], "mask_camera_voxels": counts.observed[:, 1]}
    for channel, taken in frames.associations.items():
        columns |= {f"{channel}_index": taken.message_index, f"{channel}_dt_ns": taken.dt_ns}
    empty = pa.nulls(len(frames), pa.string())
    return pa.table({**columns, "exclusion_code": empty, "exclusion_reason": empty})


def concatenated(parts: list[FrameCounts]) -> FrameCounts:
    """The counts of all parts, in frame order."""
    return FrameCounts(np.concatenate([p.classes for p in parts]), np.concatenate([p.observed for p in parts]))
