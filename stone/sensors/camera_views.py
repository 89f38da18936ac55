"""Directions of cameras, compared with their names to detect inverted transforms.

**Conventions.** Directions are in the ego frame (x forward, y left, z up). The words FRONT, BACK, REAR, LEFT, RIGHT of
a name define its direction (CAM_BACK_LEFT). The optical axis is +z, the image's up −y.
"""

import re
from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, CameraIntrinsics, Mount
from stone.sensors.projection import project

# Half the share of points that a lens's part of the horizon contains, but never more than the 5 % of design §2.
LEAST_RATIO = 0.05
# FRONT_LEFT may mean 20° or 70°; more than 75° from the name's direction is another direction. LEFT alone may be the
# left camera of a forward-looking pair, so only the opposite direction is wrong.
OFF_NAME_LIMIT_DEG, OFF_SIDE_LIMIT_DEG = 75.0, 135.0
UPRIGHT_LEAST, LEVEL_MOST = 0.5, 0.8
BACKWARD_LEAST = 0.99  # least z of a quaternion: half a turn about the vertical within 16°

WORDS = {"FRONT": (1, 0), "FORWARD": (1, 0), "BACK": (-1, 0), "REAR": (-1, 0), "LEFT": (0, 1), "RIGHT": (0, -1)}


@dataclass(frozen=True)
class CameraView:
    """A camera's view: `off_name_deg` is None if its name has no direction; `is_plausible` as for mounts."""

    seen_ratio: float
    off_name_deg: float | None
    is_elsewhere: bool
    is_plausible: bool

    def is_wrong(self, least_ratio: float) -> bool:
        return self.seen_ratio <= least_ratio or self.is_elsewhere


def named_direction(name: str) -> NDArray[np.float64] | None:
    """Return the unit direction (2,) from a channel's words; None without direction words, or if they cancel."""
    steps = [WORDS[word] for word in re.split(r"[^A-Z]+", name.upper()) if word in WORDS]
    total = np.sum(steps, axis=0, dtype=np.float64) if steps else np.zeros(2)
    length = float(np.linalg.norm(total))
    return np.asarray(total / length) if length else None


def off_name_deg(name: str, ego_from_camera: SE3) -> float | None:
    """Return the horizontal angle between optical axis and the name's direction, 0 to 180; None without a direction.

    A nearly vertical axis has no direction; the result is 180°.
    """
    wanted = named_direction(name)
    if wanted is None:
        return None
    axis = (ego_from_camera.rotation() @ (0.0, 0.0, 1.0))[:2]
    length = float(np.linalg.norm(axis))
    if length < 1e-2:
        return 180.0
    return float(np.rad2deg(np.arccos(np.clip(axis @ wanted / length, -1.0, 1.0))))


def is_elsewhere(name: str, apart_deg: float | None) -> bool:
    """Return whether a camera this far from its name's direction is another camera or has a wrong transform."""
    if apart_deg is None:
        return False
    words = set(re.split(r"[^A-Z]+", name.upper())) & set(WORDS)
    return apart_deg > (OFF_SIDE_LIMIT_DEG if words <= {"LEFT", "RIGHT"} else OFF_NAME_LIMIT_DEG)


def least_seen_ratio(intrinsics: CameraIntrinsics) -> float:
    """Return the minimum share of a sweep's points in view; below it the camera looks elsewhere than the LiDAR."""
    half_rad = intrinsics.width_px / 2 / intrinsics.fx_px
    width_rad = 2 * (half_rad if intrinsics.model == "equidistant" else float(np.arctan(half_rad)))
    return min(LEAST_RATIO, width_rad / (2 * pi) / 2)


def view_of(mount: Mount, ego_from_lidar: SE3, points_camera: NDArray[np.float64]) -> CameraView:
    """Return the camera's view of a sweep (N, 3) in its own frame; without intrinsics, it sees nothing."""
    is_in_image = project(points_camera, mount.intrinsics)[1] if mount.intrinsics else np.zeros(0, np.bool_)
    ego_from_camera = ego_from_lidar @ mount.lidar_from_sensor
    axis, up = ego_from_camera.rotation() @ (0.0, 0.0, 1.0), ego_from_camera.rotation() @ (0.0, -1.0, 0.0)
    apart_deg = off_name_deg(mount.name, ego_from_camera)
    return CameraView(
        float(is_in_image.mean()) if len(is_in_image) else 0.0,
        apart_deg,
        is_elsewhere(mount.name, apart_deg),
        bool(up[2] > UPRIGHT_LEAST and abs(axis[2]) < LEVEL_MOST),
    )


def name_findings(calibration: Calibration) -> tuple[Finding, ...]:
    """Return a warning for each camera that does not look in its name's direction, and for a LiDAR whose turn causes
    this.

    No recording is needed.
    """
    findings = []
    for mount in calibration.of_kind("camera"):
        apart_deg = off_name_deg(mount.name, calibration.ego_from_lidar @ mount.lidar_from_sensor)
        if is_elsewhere(mount.name, apart_deg):
            sentence = (
                f"{mount.name} looks {apart_deg:.0f}° away from the direction of its name (transform inverted, "
                "or names swapped?)"
            )
            findings.append(Finding("CAL-404", "warning", mount.name, sentence))
    return (*findings, *_backward_findings(calibration))


def _backward_findings(calibration: Calibration) -> tuple[Finding, ...]:
    """Return CAL-402 for a LiDAR with half a turn about the vertical, which may also be an identity in the order x, y,
    z, w.

    The finding is a warning if cameras look in their names' directions only without the turn, none if they do so with
    it, and an info if no name decides.
    """
    turned = calibration.ego_from_lidar
    if abs(turned.wxyz[3]) <= BACKWARD_LEAST:
        return ()
    straight = SE3.from_parts(np.roll(turned.wxyz, 1), turned.translation_m)
    named = [mount for mount in calibration.of_kind("camera") if named_direction(mount.name) is not None]
    with_turn, without = (
        [is_elsewhere(mount.name, off_name_deg(mount.name, turn @ mount.lidar_from_sensor)) for mount in named]
        for turn in (turned, straight)
    )
    if named and sum(with_turn) <= sum(without):
        return ()
    sentence = "ego_from_lidar: the LiDAR looks backwards; if it looks ahead, its quaternion has the order x, y, z, w"
    if named:
        sentence += (
            f" (with that turn, {sum(with_turn)} of {len(named)} cameras look away from the direction of their names)"
        )
    return (Finding("CAL-402", "warning" if named else "info", "ego_from_lidar", sentence),)
