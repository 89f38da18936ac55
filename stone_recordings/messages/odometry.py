"""nav_msgs/Odometry, geometry_msgs/PoseStamped, PoseWithCovarianceStamped: the pose of a moving frame in a fixed one.

**Conventions.** Samples are in the order of the messages; `parent_from_child` maps `child_frame_id` to `frame_id`. The
poses of geometry_msgs name no moving frame: theirs is "". Source: nav_msgs, geometry_msgs (Humble).
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone.geometry.se3 import SE3
from stone_recordings.bags.errors import IngestError
from stone_recordings.messages.batch import StampedMessage, poses_in
from stone_recordings.messages.types.table import STAMP, decode_table

TYPE = "nav_msgs/msg/Odometry"
# A larger share of messages in other frames means two sources, and neither is preferred.
MOST_OTHERS = 0.1
POSE_STAMPED, POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped"
CHILD = "child_frame_id"
# The field with the pose of each message type.
POSE_PLACES = {TYPE: "pose.pose", POSE_STAMPED: "pose", POSE_WITH_COVARIANCE: "pose.pose"}


@dataclass(frozen=True, eq=False)
class OdometrySamples:
    """N poses of one pair of frames; "" twice without a message.

    `refused_ns` (R,) are the stamps of messages without a pose, and `reason` is that of the first. `other_frames`
    counts the messages of other pairs of frames, which are left out.
    """

    stamps_ns: NDArray[np.int64]
    parent_from_child: SE3
    frame_id: str
    child_frame_id: str
    refused_ns: NDArray[np.int64]
    reason: str
    other_frames: int = 0


def decode_odometry(messages: Iterable[StampedMessage], type_name: str = TYPE) -> OdometrySamples:
    """Decode one topic of one of POSE_PLACES.

    Raises: MessageLayoutError, ByteOrderError, `MSG-304` (two sources on one topic), and PoseValueError if no message
    holds a pose.
    """
    path, named = POSE_PLACES[type_name], (CHILD,) if type_name == TYPE else ()
    table = decode_table(type_name, messages, only=(*STAMP, "header.frame_id", *named, path))
    parents = table.texts("header.frame_id")
    pairs = list(zip(parents, table.texts(CHILD) if named else [""] * len(parents), strict=True))
    counts = Counter(pairs).most_common()
    others = len(pairs) - (counts[0][1] if counts else 0)
    if others > MOST_OTHERS * len(pairs):
        raise mixed_frames(type_name, tuple(f"{parent} → {child}" for parent, child in sorted(dict(counts))))
    parent, child = counts[0][0] if counts else ("", "")
    own = np.array([row for row, pair in enumerate(pairs) if pair == (parent, child)], np.int64)
    places_m, turns = table.vectors(f"{path}.position"), table.vectors(f"{path}.orientation", "xyzw")
    decoded = poses_in(places_m[own], turns[own], type_name)
    stamps_ns = table.stamps_ns()[own]
    described = (parent, child, stamps_ns[decoded.refused], decoded.reason, others)
    return OdometrySamples(stamps_ns[decoded.rows], decoded.poses, *described)


def other_frames_finding(topic: str, samples: OdometrySamples) -> tuple[Finding, ...]:
    """Return MSG-304 for a few messages of other frames than the topic's."""
    if not samples.other_frames:
        return ()
    sentence = (
        f"{samples.other_frames} messages are not of {samples.frame_id!r} to {samples.child_frame_id!r} "
        "and are left out; check for another source on the topic"
    )
    return (Finding("MSG-304", "warning", topic, sentence),)


def mixed_frames(type_name: str, pairs: tuple[str, ...]) -> IngestError:
    return IngestError(
        "MSG-304",
        f"{type_name} changes its frames within one topic ({', '.join(pairs[:4])}); "
        f"two sources publish on it: choose one of them",
    )
