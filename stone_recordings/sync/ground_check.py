"""The check that the ground lies at the ego origin and is level there, as the calibration implies.

**Conventions.** The check uses sweeps spread over the run (`stone.sensors.ground_plane`). It measures the joint error
of the LiDAR's mount and of the ego frame. Errors below `TOLERATED_M` and `TOLERATED_RAD` can come from terrain and give
no finding. `--ground auto` always applies the measured height, which is accurate to a centimetre. It applies the tilt
only beyond the tolerance, because terrain changes the measured tilt by half a degree.
"""

from dataclasses import replace

import numpy as np

from stone.errors import Refused
from stone.findings import Finding
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, entry_of
from stone.sensors.driving_direction import DrivingDirection, driving_direction
from stone.sensors.ego_path import track_of
from stone.sensors.ground_plane import BAND_M, GroundFit, above, ground_fit, is_off_ground, surely_off_ground
from stone.sensors.ground_points import plane_around
from stone.sensors.sequence import Sequence, SweepSource
from stone.sensors.sweep_tilt import SweepTilt
from stone_recordings.bags.bag import Bag
from stone_recordings.poses.extrinsics import BASE_FRAMES
from stone_recordings.poses.static_tree import StaticTree
from stone_recordings.sync.ground_looks import SeenWay, points_around, seen_ahead, seen_along
from stone_recordings.sync.sweeps import BagSweeps, SweepsOfOpenBag

SWEEPS, EARLY_SWEEPS = 40, 12
OF_MOTION = ("ins", "imu")
MOST_ERROR_ALONG, MOST_ERROR_ACROSS = np.tan(np.deg2rad([0.3, 0.7])).tolist()
ROUNDS, SETTLED_M, SETTLED_RAD = 8, 0.0001, 0.00001


def measured_ground(sequence: Sequence, sweeps: SweepSource, seen: SeenWay | None) -> GroundFit | None:
    """Return the measured ground in the ego frame, from sweeps of the whole run; None if too few sweeps show it."""
    picked = np.unique(np.linspace(0, len(sequence.frames) - 1, SWEEPS).round().astype(np.int64)).tolist()
    planes = (plane_around(points) for points in seen_ahead(sequence, sweeps, picked))
    fit = ground_fit([plane for plane in planes if plane is not None])
    if fit is None or seen is None or seen.tilt is None:
        return fit
    return _linked(fit, seen.tilt, driving_direction(track_of(sequence)))


def early_ground(bag: Bag, lidar_topic: str, calibration: Calibration) -> GroundFit | None:
    """Return the ground as `measured_ground` does, from a few raw sweeps, without poses, frames or map."""
    times_ns = bag.log_times_ns(lidar_topic)
    sweeps = SweepsOfOpenBag(BagSweeps(bag.path, lidar_topic, np.arange(len(times_ns)), times_ns, None), bag)
    picked = np.unique(np.linspace(0, len(times_ns) - 1, EARLY_SWEEPS).round().astype(np.int64)).tolist()
    planes = (plane_around(points_around(calibration, sweeps, index)) for index in picked)
    return ground_fit([plane for plane in planes if plane is not None])


def early_refusal(bag: Bag, lidar_topic: str, calibration: Calibration, band_m: float = BAND_M) -> Refused | None:
    """Return the refusal if a first measurement of the ground is far off; None if it is not, or too few sweeps show it.

    Raises the errors of reading a sweep.
    """
    ground = early_ground(bag, lidar_topic, calibration)
    return None if ground is None else surely_off_ground(ground, calibration.ego_from_lidar, band_m)


def recorded_ground_finding(ground: GroundFit, tree: StaticTree, lidar_frame: str) -> tuple[Finding, ...]:
    """Return CAL-440 if the base on which /tf_static mounts the LiDAR is not on the ground; `ground` is in the LiDAR's
    frame.
    """
    placed = [(base, tree.recorded(base, lidar_frame)) for base in BASE_FRAMES]
    bases = {base: base_from_lidar for base, base_from_lidar in placed if base_from_lidar is not None}
    off = {base: seen for base, mount in bases.items() if is_off_ground(seen := ground.seen_from(mount))}
    if len(off) < len(bases) or not off:  # any base may be the ego frame
        return ()
    base, seen = next(iter(off.items()))
    right = seen.untilted().corrected(bases[base])
    sentence = (
        f"with the LiDAR's mount on {base!r} in /tf_static, the ground lies {above(seen)} ({seen.sweeps} sweeps). "
        f"Labelling refuses such a calibration. Enter {entry_of(right)}, or use --ground auto, which mounts the LiDAR "
        f"{right.translation_m[2]:.2f} m above the ground"
    )
    return (Finding("CAL-440", "warning", "", sentence),)


def _linked(fit: GroundFit, tilt: SweepTilt, direction: DrivingDirection | None) -> GroundFit:
    """Return the fit with the tilt of the sweeps in the map, and the slope along x from this tilt and the way, if both
    are known well enough.
    """
    fit = replace(fit, map_slope_y=tilt.slope_y if tilt.error_y < MOST_ERROR_ACROSS else None)
    if direction is None or np.hypot(tilt.error_x, direction.pitch_error_rad) > MOST_ERROR_ALONG:
        return fit
    return replace(fit, map_slope_x=tilt.slope_x, slope_x=tilt.slope_x + float(np.tan(direction.pitch_rad)))


def is_off(fit: GroundFit | None) -> bool:
    """Return whether the ground is so far off that terrain cannot be the cause."""
    return fit is not None and (fit.is_high_or_low or fit.is_tilted)


def corrected(calibration: Calibration, fit: GroundFit) -> Calibration:
    """Return the calibration with the LiDAR mounted so that the ground lies at the ego origin."""
    return _mounted(calibration, fit.corrected(calibration.ego_from_lidar), fit.tilt_rad > 0.0 and fit.is_map_tilted)


def _mounted(calibration: Calibration, ego_from_lidar: SE3, is_body_kept: bool) -> Calibration:
    """Return the calibration with the LiDAR mounted there; with `is_body_kept`, sensors of the robot's own motion keep
    their place on the robot, else their place relative to the LiDAR.
    """
    turn = ego_from_lidar.inverse() @ calibration.ego_from_lidar
    mounts = tuple(
        replace(mount, lidar_from_sensor=turn @ mount.lidar_from_sensor)
        if is_body_kept and mount.kind in OF_MOTION
        else mount
        for mount in calibration.mounts
    )
    return replace(calibration, ego_from_lidar=ego_from_lidar, mounts=mounts)


def settled(sequence: Sequence, sweeps: SweepSource, fit: GroundFit) -> Calibration:
    """Return the calibration with the LiDAR mounted so that the ground is at the ego origin to within `SETTLED_M`.

    A tilt beyond terrain is levelled to within `SETTLED_RAD`. The result does not depend on the entered height.
    """
    calibration, left = sequence.calibration, fit if fit.is_tilted else fit.untilted()
    mount = calibration.ego_from_lidar
    for _ in range(ROUNDS):
        mount = left.corrected(mount)
        turned = replace(sequence, calibration=replace(calibration, ego_from_lidar=mount))
        again = measured_ground(turned, sweeps, seen_along(turned, sweeps) if fit.is_tilted else None)
        if again is None:
            break
        left = again if fit.is_tilted else again.untilted()
        if abs(left.height_m) < SETTLED_M and left.tilt_rad < SETTLED_RAD:
            break
    return _mounted(calibration, mount, fit.is_tilted and fit.is_map_tilted)


def ground_findings(sequence: Sequence, fit: GroundFit | None) -> tuple[Finding, ...]:
    """Return CAL-433 with the values to enter if the ground is off; CAL-435 if it cannot be measured."""
    if fit is None:
        unseen = "too few sweeps show the ground around the robot to check the height of the LiDAR's mount"
        return (Finding("CAL-435", "info", "", unseen),)
    if not is_off(fit):
        return ()
    right = corrected(sequence.calibration, fit.beyond_terrain())
    entries = f"{entry_of(right.ego_from_lidar)}{_moved_mounts(sequence.calibration, right)}"
    sentence = (
        f"the ground lies {above(fit)} and tilts by {np.rad2deg(fit.tilt_rad):.1f}° in the ego frame ({fit.sweeps} "
        f"sweeps, 5 to 95 %: {fit.low_m:+.2f} to {fit.high_m:+.2f} m). Check the LiDAR's mount in the calibration and "
        f"the ego origin, which is on the ground. {entries} would "
        "correct it; --ground auto corrects it for this run"
        f"{'. Without a correction, labelling refuses the run' if fit.is_mount_tilted else ''}"
    )
    return (Finding("CAL-433", "warning", "", sentence),)


def applied_finding(fit: GroundFit, calibration: Calibration) -> Finding:
    """Return CAL-434: the correction that `--ground auto` applied, from the corrected `calibration`."""
    sentence = (
        f"the ground lay {above(fit)} and tilted by {np.rad2deg(fit.tilt_rad):.1f}° in the ego frame; --ground auto "
        f"corrected the LiDAR's mount to {entry_of(calibration.ego_from_lidar)}"
    )
    return Finding("CAL-434", "info", "", sentence)


def _moved_mounts(before: Calibration, after: Calibration) -> str:
    """Return the rotation of each mount that stays on the robot while the LiDAR is turned."""
    pairs = zip(before.mounts, after.mounts, strict=True)
    return "".join(f", {entry_of(new)}" for old, new in pairs if new is not old)
