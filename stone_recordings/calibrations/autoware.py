"""Autoware: sensor_kit_calibration.yaml and sensors_calibration.yaml, x y z roll pitch yaw by parent and child.

**Conventions.** Angles are URDF's: fixed axes, R = Rz(yaw) Ry(pitch) Rx(roll). The kit file places sensors on
`sensor_kit_base_link`, the other one places that frame on `base_link`; a rig needs both. Camera frames are links (x
forward): the optical frame is turned by (−90°, 0, −90°) from them, as in Autoware's xacro. Autoware's files contain no
intrinsics: camera_info files go into the same bundle.
"""

import numpy as np
from numpy.typing import NDArray

from stone.sensors.calibration_checks import Findings, rotation_and_translation
from stone_recordings.calibrations.part import CalibrationPart, Edge, Node

AXES = ("x", "y", "z", "roll", "pitch", "yaw")


def is_autoware(content: dict[str, object]) -> bool:
    """Return whether these are mappings of mappings of the six numbers."""
    children = [child for inner in content.values() if isinstance(inner, dict) for child in inner.values()]
    are_mappings = all(isinstance(inner, dict) for inner in content.values())
    return (
        are_mappings
        and bool(children)
        and all(isinstance(child, dict) and set(AXES) <= set(child) for child in children)
    )


def autoware(document: Node) -> CalibrationPart:
    """Return a part with one edge for each child."""
    edges, findings = list[Edge](), Findings()
    for parent, children in document.entries().items():
        for child, node in children.entries().items():
            x, y, z, roll, pitch, yaw = (node.at(axis).number() for axis in AXES)
            transform, noticed = rotation_and_translation(
                child, rotation_from_rpy(roll, pitch, yaw), np.array([x, y, z])
            )
            edges.append(Edge(parent, child, transform))
            findings += noticed
    return CalibrationPart(document.file, "autoware", tuple(edges), findings=findings)


def rotation_from_rpy(roll: float, pitch: float, yaw: float) -> NDArray[np.float64]:
    """Return Rz(yaw) Ry(pitch) Rx(roll), (3, 3); NaN if an angle is infinite."""
    with np.errstate(invalid="ignore"):
        (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
