"""What the recording's own /tf_static says about the mounts, and where it contradicts the calibration.

**Conventions.** The calibration wins; a difference beyond 1 cm or 0.2° is a warning, never a silent repair. A frame's
transform is composed along the tree, the last transform published for a pair of frames being the valid one.
"""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from services.ingest.messages.tf import TransformSamples
from stone.calibration import Calibration
from stone.findings import Finding
from stone.se3 import SE3

OFFSET_LIMIT_M = 0.01
TURN_LIMIT_DEG = 0.2
# What robots call their base; the ego frame is this one (REP 105).
BASE_FRAMES = ("base_link", "base_footprint", "base", "ego", "ego_vehicle", "body")


@dataclass(frozen=True, eq=False)
class StaticTree:
    """Fixed transforms between named frames."""

    edges: dict[tuple[str, str], SE3]

    def transform(self, dst: str, src: str) -> SE3 | None:
        """`dst_from_src` along the shortest path, or None where the frames are not connected."""
        seen, waiting = {dst}, deque([(dst, SE3.identity())])
        while waiting:
            frame, dst_from_frame = waiting.popleft()
            if frame == src:
                return dst_from_frame
            for (near, far), near_from_far in self.edges.items():
                if near == frame and far not in seen:
                    seen.add(far)
                    waiting.append((far, dst_from_frame @ near_from_far))
        return None


def static_tree(samples: Iterable[TransformSamples]) -> StaticTree:
    edges: dict[tuple[str, str], SE3] = {}
    for pair in samples:
        parent, child, parent_from_child = plain(pair.parent), plain(pair.child), pair.parent_from_child[-1]
        edges[(parent, child)] = parent_from_child
        edges[(child, parent)] = parent_from_child.inverse()
    return StaticTree(edges)


def plain(frame_id: str) -> str:
    """tf2 knows no leading slash, some drivers still write one."""
    return frame_id.lstrip("/")


def cross_check(tree: StaticTree, calibration: Calibration, lidar_frame: str) -> tuple[Finding, ...]:
    """A warning for each transform that both know and that differ; nothing for what only one of them knows."""
    pairs = [("ego_from_lidar", tree.transform(base, lidar_frame), calibration.ego_from_lidar) for base in BASE_FRAMES]
    for mount in calibration.mounts:
        recorded = tree.transform(lidar_frame, plain(mount.frame_id)) if mount.frame_id else None
        pairs.append((mount.name, recorded, mount.lidar_from_sensor))
    findings = (_difference(name, recorded, calibrated) for name, recorded, calibrated in pairs if recorded is not None)
    return tuple(finding for finding in findings if finding is not None)


def turn_deg(transform: SE3) -> float:
    """Angle of a single rotation, degrees in [0, 180]."""
    return float(np.rad2deg(2 * np.arctan2(np.linalg.norm(transform.wxyz[1:]), abs(transform.wxyz[0]))))


def _difference(name: str, recorded: SE3, calibrated: SE3) -> Finding | None:
    apart = calibrated.inverse() @ recorded
    offset_m, angle_deg = float(np.linalg.norm(apart.translation_m)), turn_deg(apart)
    if offset_m <= OFFSET_LIMIT_M and angle_deg <= TURN_LIMIT_DEG:
        return None
    sentence = (
        f"tf_static puts it {offset_m * 100:.1f} cm and {angle_deg:.2f}° from where the calibration does; "
        f"the calibration is used (limits {OFFSET_LIMIT_M * 100:g} cm, {TURN_LIMIT_DEG}°)"
    )
    return Finding("CAL-414", "warning", name, sentence)
