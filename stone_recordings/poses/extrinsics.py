"""Comparison of the recording's /tf_static with the mounts in the calibration.

**Conventions.** The calibration takes precedence; a difference beyond 1 cm or 0.2° is a warning, never a silent repair.
A frame's transform is composed along the tree; if a pair of frames has several transforms, the last one counts.
"""

from collections.abc import Iterable

import numpy as np

from stone.findings import Finding
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration
from stone_recordings.messages.tf import TransformSamples
from stone_recordings.poses.static_tree import StaticTree

OFFSET_LIMIT_M = 0.01
TURN_LIMIT_DEG = 0.2
# Usual names of a robot's base; the ego frame is this base (REP 105).
BASE_FRAMES = ("base_link", "base_footprint", "base", "ego", "ego_vehicle", "body")


def static_tree(samples: Iterable[TransformSamples]) -> StaticTree:
    return StaticTree.of((plain(pair.parent), plain(pair.child), pair.parent_from_child[-1]) for pair in samples)


def plain(frame_id: str) -> str:
    """Return a frame name without a leading slash: tf2 has none, some drivers still write it."""
    return frame_id.lstrip("/")


def cross_check(tree: StaticTree, calibration: Calibration, lidar_frame: str) -> tuple[Finding, ...]:
    """Return a warning for each transform that differs between tree and calibration; a transform in only one gives
    none.

    Robots publish several bases (base_link, base_footprint); the ego frame need only agree with one of them. A frame
    with the LiDAR's name is not a transform of tf_static.
    """
    is_placed = not tree.unplaced
    findings = [_ego_difference(tree, calibration, lidar_frame)]
    for mount in calibration.mounts:
        recorded = tree.recorded(lidar_frame, plain(mount.frame_id)) if mount.frame_id else None
        if recorded is not None:
            findings.append(_difference(mount.name, recorded, mount.lidar_from_sensor, is_placed))
    return tuple(finding for finding in findings if finding is not None)


def _ego_difference(tree: StaticTree, calibration: Calibration, lidar_frame: str) -> Finding | None:
    recorded = [tree.recorded(base, lidar_frame) for base in BASE_FRAMES]
    known, is_placed = calibration.ego_from_lidar, not tree.unplaced
    differences = [
        _difference("ego_from_lidar", transform, known, is_placed) for transform in recorded if transform is not None
    ]
    return None if None in differences or not differences else differences[0]


def turn_deg(transform: SE3) -> float:
    """Return the angle of a single rotation, degrees in [0, 180]."""
    return float(np.rad2deg(2 * np.arctan2(np.linalg.norm(transform.wxyz[1:]), abs(transform.wxyz[0]))))


def _difference(name: str, recorded: SE3, calibrated: SE3, is_placed: bool) -> Finding | None:
    """Return the finding for two different transforms, or None; an unplaced transform is compared by its rotation."""
    if not is_placed:
        recorded = SE3.from_parts(recorded.wxyz, calibrated.translation_m)
    apart = calibrated.inverse() @ recorded
    if _is_near(apart):
        return None
    offset_m, angle_deg = float(np.linalg.norm(apart.translation_m)), turn_deg(apart)
    sentence = (
        f"tf_static puts it {offset_m * 100:.1f} cm and {angle_deg:.2f}° from its place in the calibration; "
        f"the calibration is used (limits {OFFSET_LIMIT_M * 100:g} cm, {TURN_LIMIT_DEG}°)"
    )
    if _is_near(calibrated @ recorded):
        sentence += "; it is the inverse of tf_static's transform: one of the two is inverted"
    return Finding("CAL-414", "warning", name, sentence)


def _is_near(apart: SE3) -> bool:
    return float(np.linalg.norm(apart.translation_m)) <= OFFSET_LIMIT_M and turn_deg(apart) <= TURN_LIMIT_DEG
