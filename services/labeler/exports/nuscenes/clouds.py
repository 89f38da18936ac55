"""Point clouds as nuScenes keeps them: LiDAR returns as bare floats, radar detections as binary PCD.

**Conventions.** Points are in the sensor's own axes: a sweep's at the frame's stamp, a radar's when it measured. Only
finite rows are written. Source: `LidarPointCloud.from_file` and `RadarPointCloud.from_file` of nuscenes-devkit 1.2.
"""

import numpy as np
from numpy.typing import NDArray

from stone.sensors.samples import LidarSample, RadarSample

RADAR_RECORD = np.dtype(
    [
        ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("dyn_prop", "i1"), ("id", "<i2"), ("rcs", "<f4"), ("vx", "<f4"),
        ("vy", "<f4"), ("vx_comp", "<f4"), ("vy_comp", "<f4"), ("is_quality_valid", "i1"), ("ambig_state", "i1"),
        ("x_rms", "i1"), ("y_rms", "i1"), ("invalid_state", "i1"), ("pdh0", "i1"), ("vx_rms", "i1"), ("vy_rms", "i1"),
    ]
)  # fmt: skip
# What these detections do not say, in the words of the schema: motion unknown, Doppler unambiguous, valid.
UNKNOWN_MOTION, UNAMBIGUOUS, VALID, QUALITY_VALID = 4, 3, 0, 1
LAST_ID = 32767


def lidar_bytes(sample: LidarSample) -> bytes:
    """`.pcd.bin`: x y z intensity ring, five float32 a return."""
    rows = np.empty((len(sample.points_lidar), 5), "<f4")
    rows[:, :3], rows[:, 3], rows[:, 4] = sample.points_lidar, sample.intensity, sample.ring
    return rows[np.isfinite(rows).all(axis=1)].tobytes()


def radar_bytes(sample: RadarSample) -> bytes:
    """`.pcd`: the 18 fields of nuScenes; velocities are the measured rate along the ray, in plan.

    A scan without a finite detection holds one row of NaN, which the devkit reads as none.
    """
    records = _records(sample)
    if not len(records):
        records = np.zeros(1, RADAR_RECORD)
        for name in ("x", "y", "z", "rcs", "vx", "vy", "vx_comp", "vy_comp"):
            records[name] = np.nan
    # The devkit's reader wants one byte more than the last record.
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
