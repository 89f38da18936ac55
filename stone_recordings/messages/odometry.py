"""nav_msgs/msg/Odometry: the pose of a moving frame in a fixed one.

**Conventions.** Samples are in the order of the messages; `parent_from_child` maps `child_frame_id` to `frame_id`.
Source: nav_msgs (Humble).
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone_recordings.bags.errors import MixedFramesError
from stone_recordings.messages.batch import StampedMessage, poses_in
from stone_recordings.messages.types.table import STAMP, decode_table

TYPE = "nav_msgs/msg/Odometry"
_COLUMNS = (*STAMP, "header.frame_id", "child_frame_id", "pose.pose")


@dataclass(frozen=True, eq=False)
class OdometrySamples:
    """N poses of one pair of frames; "" twice when there is no message.

    `refused_ns` (R,) are the stamps of messages that hold no pose, and `reason` is why the first of them holds none.
    """

    stamps_ns: NDArray[np.int64]
    parent_from_child: SE3
    frame_id: str
    child_frame_id: str
    refused_ns: NDArray[np.int64]
    reason: str


def decode_odometry(messages: Iterable[StampedMessage]) -> OdometrySamples:
    """Raises: MessageLayoutError, ByteOrderError, MixedFramesError (two sources on one topic), and PoseValueError where
    no message holds a pose."""
    table = decode_table(TYPE, messages, only=_COLUMNS)
    pairs = set(zip(table.texts("header.frame_id"), table.texts("child_frame_id"), strict=True))
    if len(pairs) > 1:
        raise MixedFramesError(TYPE, tuple(f"{parent} → {child}" for parent, child in sorted(pairs)))
    parent, child = next(iter(pairs), ("", ""))
    found = poses_in(table.vectors("pose.pose.position"), table.vectors("pose.pose.orientation", "xyzw"), TYPE)
    stamps_ns = table.stamps_ns()
    return OdometrySamples(stamps_ns[found.rows], found.poses, parent, child, stamps_ns[found.refused], found.reason)
