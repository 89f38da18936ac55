"""The rig by /tf_static: the viewing direction of radars, and transforms that cannot be right.

**Conventions.** A radar looks along the x axis of its frame; its yaw is in the frame of the robot's base, positive to
the left. Its channel is the nearest of eight directions. Names take precedence over yaws. A number in a frame's name is
an angle only if the numbers of all radars are.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stone.findings import Finding
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, Mount
from stone_recordings.poses.extrinsics import BASE_FRAMES, plain
from stone_recordings.poses.static_tree import StaticTree
from stone_recordings.topics.profiles import PREFIX, channel_of

DIRECTIONS = ("FRONT", "FRONT_LEFT", "LEFT", "BACK_LEFT", "BACK", "BACK_RIGHT", "RIGHT", "FRONT_RIGHT")
STEP_DEG = 360.0 / len(DIRECTIONS)
UPRIGHT = 0.3  # share of the x axis in plan; a steeper axis has no yaw
TOLERATED_DEG, OTHER_WAY_DEG = 10.0, 60.0
IN_BASE = "its messages are in the frame of the robot's base itself"
ANGLE_STEP_DEG, LEAST_ANGLE_DEG = 15, 90


@dataclass(frozen=True)
class RecordedRadar:
    """A radar's topic, and the frame of its messages."""

    topic: str
    frame_id: str


def base_of(tree: StaticTree, frame_id: str) -> tuple[str, SE3] | None:
    """Return the base to which the frame is connected, and the frame's pose in it; None without a base."""
    candidates = ((base, tree.transform(base, plain(frame_id))) for base in BASE_FRAMES)
    return next(((base, base_from_frame) for base, base_from_frame in candidates if base_from_frame is not None), None)


def _is_base(tree: StaticTree, frame: str) -> bool:
    """Return whether the frame is its own base, so that no transform gives its place."""
    base = base_of(tree, frame)
    return base is not None and base[0] == frame


def yaw_deg(tree: StaticTree, frame_id: str) -> float | None:
    """Return the yaw in (−180, 180]; None if the frame is unknown, or its x axis points up or down."""
    base = base_of(tree, frame_id)
    if base is None:
        return None
    x, y, _ = base[1].rotation()[:, 0]
    return float(np.rad2deg(np.arctan2(y, x))) if np.hypot(x, y) > UPRIGHT else None


def radar_channels(tree: StaticTree, radars: Sequence[RecordedRadar]) -> Mapping[str, str]:
    """Return the channels, by frame, of radars whose names give no viewing direction."""
    channels = dict[str, str]()
    for radar in radars:
        yaw = yaw_deg(tree, radar.frame_id)
        if yaw is not None and channel_of("radar", radar.topic, radar.frame_id, {}) is None:
            channels[plain(radar.frame_id)] = f"{PREFIX['radar']}_{DIRECTIONS[round(yaw / STEP_DEG) % len(DIRECTIONS)]}"
    return channels


def direction_findings(tree: StaticTree, radars: Sequence[RecordedRadar]) -> Iterator[Finding]:
    """Yield TOP-117 for each radar whose channel comes from its yaw, or whose name and yaw contradict each other."""
    channels, yaws = radar_channels(tree, radars), {radar.frame_id: yaw_deg(tree, radar.frame_id) for radar in radars}
    known = {frame: yaw for frame, yaw in yaws.items() if yaw is not None}
    angles = _contradicting(_angles_named(list(known)), known)
    for radar in radars:
        frame, yaw = plain(radar.frame_id), yaws[radar.frame_id]
        if yaw is None:
            continue
        seen = f"/tf_static turns its frame {frame!r} by {yaw:+.0f}°" if not _is_base(tree, frame) else IN_BASE
        named, angle = channel_of("radar", radar.topic, radar.frame_id, {}), angles.get(radar.frame_id)
        if named is not None and _apart_deg(yaw, _yaw_of(named)) > OTHER_WAY_DEG:
            sentence = f"its name indicates {named}, but {seen}; the name is used (to change it: --topic CHANNEL=TOPIC)"
            yield Finding("TOP-117", "warning", radar.topic, sentence)
        elif named is None and angle is not None:
            sentence = f"{seen}, but its name contains {angle}°; the yaw is used, which gives {channels[frame]}"
            yield Finding("TOP-117", "warning", radar.topic, sentence)
        elif named is None:
            yield Finding("TOP-117", "info", radar.topic, f"{seen}: it is {channels[frame]}")


def unplaced_finding(tree: StaticTree) -> tuple[Finding, ...]:
    """Return CAL-438 if /tf_static has every sensor in one point."""
    frames = tree.unplaced
    if not frames:
        return ()
    sentence = (
        f"/tf_static puts {', '.join(frames[:6])} at one point, with translations of zero, so these were probably "
        "never "
        "entered. Rotations come from /tf_static, positions from the calibration"
    )
    return (Finding("CAL-438", "warning", "", sentence),)


def with_radars(
    calibration: Calibration, tree: StaticTree, radars: Sequence[RecordedRadar], channels: Mapping[str, str]
) -> tuple[Calibration, tuple[Finding, ...]]:
    """Return the calibration with a mount for each radar that only /tf_static places; CAL-439 reports them.

    `channels` are chosen channels, by topic. Without positions a radar is at the origin of the ego frame.
    """
    named = radar_channels(tree, radars)
    mounts, findings = list[Mount](), list[Finding]()
    for radar in radars:
        frame = plain(radar.frame_id)
        channel = channels.get(radar.topic) or channel_of("radar", radar.topic, radar.frame_id, named)
        base, known = base_of(tree, frame), {mount.name for mount in (*calibration.mounts, *mounts)}
        if base is None or channel is None or channel in known or _has_mount(calibration, frame):
            continue
        lidar_from_radar = calibration.ego_from_lidar.inverse() @ base[1]
        mounts.append(Mount(channel, "radar", lidar_from_radar, radar.frame_id))
        position = (
            "at the ego origin, because its position is unknown" if tree.unplaced else f"at its place on {base[0]}"
        )
        turned = (
            f"has the rotation of {frame!r} in /tf_static, {position}" if base[0] != frame else f"lies there: {IN_BASE}"
        )
        sentence = f"the calibration does not place it; {channel} {turned}"
        findings.append(Finding("CAL-439", "info", radar.topic, sentence))
    return replace(calibration, mounts=(*calibration.mounts, *mounts)), tuple(findings)


def _has_mount(calibration: Calibration, frame: str) -> bool:
    return any(mount.frame_id and plain(mount.frame_id) == frame for mount in calibration.mounts)


def _angles_named(frame_ids: Sequence[str]) -> Mapping[str, int]:
    """Return the angle at the end of each name, in degrees; none if they may be mere numbers."""
    matches = {frame_id: re.search(r"(\d{1,3})$", frame_id) for frame_id in frame_ids}
    angles = {frame_id: int(match[1]) for frame_id, match in matches.items() if match}
    is_round = all(angle % ANGLE_STEP_DEG == 0 and angle < 360 for angle in angles.values())
    is_all = len(angles) == len(set(frame_ids)) == len(set(angles.values())) > 1
    return angles if is_all and is_round and max(angles.values()) >= LEAST_ANGLE_DEG else {}


def _yaw_of(channel: str) -> float:
    return DIRECTIONS.index(channel.removeprefix(f"{PREFIX['radar']}_")) * STEP_DEG


def _apart_deg(first: float, other: float) -> float:
    return abs((first - other + 180.0) % 360.0 - 180.0)


def _contradicting(angles: Mapping[str, int], yaws: Mapping[str, float]) -> Mapping[str, int]:
    """Return the angles that are not the yaws; none if all are, to the left or to the right."""
    apart = [
        {frame: angle for frame, angle in angles.items() if _apart_deg(way * angle, yaws[frame]) > TOLERATED_DEG}
        for way in (1, -1)
    ]
    return apart[0] if all(apart) else {}
