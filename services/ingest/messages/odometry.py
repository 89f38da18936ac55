"""nav_msgs/msg/Odometry: the pose of a moving frame in a fixed one.

**Conventions.** Samples are in the order of the messages; `parent_from_child` maps `child_frame_id` to `frame_id`.
Source: nav_msgs (Humble).
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.ingest.cdr import HEADER, Field, groups
from services.ingest.errors import MixedFramesError
from services.ingest.messages.batch import Stamped, payloads_of, poses
from stone.se3 import SE3

TYPE = "nav_msgs/msg/Odometry"
FIELDS: tuple[Field, ...] = (
    *HEADER,
    ("child_frame_id", "string"),
    ("position", "3f8"),
    ("orientation", "4f8"),
    ("pose_covariance", "36f8"),
    ("twist", "6f8"),
    ("twist_covariance", "36f8"),
)


@dataclass(frozen=True, eq=False)
class OdometrySamples:
    """N poses of one pair of frames; "" twice when there is no message."""

    stamps_ns: NDArray[np.int64]
    parent_from_child: SE3
    frame_id: str
    child_frame_id: str


def decode_odometry(messages: Iterable[Stamped]) -> OdometrySamples:
    """Raises: MessageLayoutError, ByteOrderError, MixedFramesError (two sources on one topic), PoseValueError."""
    payloads = payloads_of(messages)
    stamps_ns = np.empty(len(payloads), np.int64)
    positions, quaternions = np.empty((len(payloads), 3)), np.empty((len(payloads), 4))
    pairs: set[tuple[str, str]] = set()
    for group in groups(payloads, lambda _payload: FIELDS, TYPE):
        stamps_ns[group.rows] = group.stamps_ns()
        positions[group.rows] = group.table["position"]
        quaternions[group.rows] = group.table["orientation"]
        pairs |= set(zip(group.texts("frame_id", TYPE), group.texts("child_frame_id", TYPE), strict=True))
    if len(pairs) > 1:
        raise MixedFramesError(TYPE, tuple(f"{parent} → {child}" for parent, child in sorted(pairs)))
    parent, child = next(iter(pairs), ("", ""))
    return OdometrySamples(stamps_ns, poses(positions, quaternions, TYPE), parent, child)
