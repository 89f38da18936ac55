"""The check that poses do not drift in z against the ground driven over, and the correction of such drift.

**Conventions.** The check uses sweeps spread along the way (`stone.sensors.ground_links`), after the LiDAR's mount is
known to be right. Within `stone.sensors.height_drift.TOLERATED_M` poses stay as given, bit for bit. Beyond it, the
correction moves every pose of the frames and of the track between them in z only, interpolated in time.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone.geometry.se3 import SE3
from stone.sensors.ground_links import LEAST_FLOOR_M, SAME_FLOOR_RATIO, TERRAIN_RAD, drift
from stone.sensors.ground_plane import GroundFit
from stone.sensors.height_drift import HeightDrift
from stone.sensors.sequence import Sequence, SweepSource
from stone_recordings.sync.ground_check import is_off
from stone_recordings.sync.ground_looks import SeenWay, seen_along

Array = NDArray[np.float64]


def height_followed(sequence: Sequence, sweeps: SweepSource, fit: GroundFit | None, seen: SeenWay) -> Sequence:
    """Return the sequence with its drift in z measured, and corrected if it is drift.

    Returns the sequence itself if the ground under the robot, `fit`, was not measured, or is off because of the mount.
    """
    if fit is None or is_off(fit) or len(seen.rows) < 2:
        return sequence
    height, up_m = drift(seen.links, seen.way, _floor_m(sequence))
    if height.is_beyond_terrain and fit.tilt_rad > TERRAIN_RAD:
        level = replace(fit, height_m=0.0).corrected(SE3.identity())
        seen = seen_along(sequence, sweeps, level)
        height, up_m = min(
            (height, up_m), drift(seen.links, seen.way, _floor_m(sequence)), key=lambda choice: choice[0].apart_m
        )
    if height.is_beyond_terrain and height.is_followable:
        sequence, height = _moved(sequence, seen.rows, up_m), replace(height, is_followed=True)
    return replace(sequence, height_drift=height, findings=(*sequence.findings, *_findings(height)))


def _floor_m(sequence: Sequence) -> float:
    """Return the least distance between two floors that this robot can drive on, m."""
    return max(SAME_FLOOR_RATIO * float(sequence.calibration.ego_from_lidar.translation_m[2]), LEAST_FLOOR_M)


def _moved(sequence: Sequence, rows: NDArray[np.int64], up_m: Array) -> Sequence:
    """Return the sequence with `up_m` (K,) added to z at the frames `rows` (K,), interpolated in time between them."""
    frames, track = sequence.frames, sequence.track
    stamps_ns = frames.stamps_ns[rows]
    frames = replace(frames, map_from_ego=_raised(frames.map_from_ego, np.interp(frames.stamps_ns, stamps_ns, up_m)))
    if track is None:
        return replace(sequence, frames=frames)
    raised = _raised(track.map_from_ego, np.interp(track.stamps_ns, stamps_ns, up_m))
    return replace(sequence, frames=frames, track=replace(track, map_from_ego=raised))


def _raised(poses: SE3, up_m: Array) -> SE3:
    values = poses.wxyz_xyz.copy()
    values[:, 6] += up_m
    return SE3(values)


def _findings(height: HeightDrift) -> tuple[Finding, ...]:
    """Return SYN-514 if the drift was corrected, SYN-515 if it was not."""
    if not height.is_beyond_terrain:
        return ()
    where = (
        f"two observations of the same ground lie up to {height.apart_m:.2f} m apart by the poses "
        f"({height.links} pairs of "
        f"{height.looks} sweeps along {height.driven_m:.0f} m)"
    )
    if height.is_followed:
        sentence = (
            f"{where}. The poses drift in z, by {height.span_m:.2f} m over the run, and were corrected with the "
            "ground. "
            f"Such observations then lie {height.left_m:.2f} m apart (95 %)"
        )
        return (Finding("SYN-514", "warning", "", sentence),)
    sentence = (
        f"{where}. Correcting the poses in z leaves {height.left_m:.2f} m (95 %), so this is not a slow drift, and the "
        "poses stay as given. Check that they belong to this robot and time, and check the LiDAR's mount"
    )
    return (Finding("SYN-515", "warning", "", sentence),)
