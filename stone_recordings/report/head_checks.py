"""Findings about missing values in the heads of a topic's messages: frame, points, date.

**Conventions.** MSG-312 clouds of a LiDAR without points, TOP-115 messages without a `frame_id`, TIM-211 stamps without
a date. A radar's list may be empty, and a receiver needs no frame.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from struct import Struct

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone_recordings.bags.message_store import Topic
from stone_recordings.clocks.constants import FIRST_DATE_NS
from stone_recordings.messages.sweep_clouds import SWEEP_TYPES, points_declared
from stone_recordings.messages.types.cdr import HEAD_BYTES
from stone_recordings.topics.roles import Role

FRAMED_ROLES: tuple[Role, ...] = ("lidar", "camera", "radar", "imu", "odometry", "pose")
DATED_ROLES: tuple[Role, ...] = (*FRAMED_ROLES, "gnss", "ins")
_TEXT_AT = HEAD_BYTES + 8  # after the stamp
_U32 = Struct("<I")


@dataclass
class HeadCounts:
    """The number of a topic's messages without a frame, and of its clouds without points."""

    frameless: int = 0
    empty: int = 0

    def take(self, head: memoryview, type_name: str) -> None:
        """Count a message that begins with a header; a truncated head is not counted."""
        if len(head) < _TEXT_AT + _U32.size:
            return
        length = _U32.unpack_from(head, _TEXT_AT)[0]
        self.frameless += length <= 1
        if type_name in SWEEP_TYPES:
            self.empty += points_declared(head, type_name) == 0


def head_findings(topic: Topic, role: Role, counts: HeadCounts, stamps_ns: NDArray[np.int64]) -> Iterator[Finding]:
    """Yield the findings of one topic; `stamps_ns` (N,) are its header stamps in log order."""
    if role == "lidar" and counts.empty:
        message = f"{counts.empty} of {topic.count} clouds hold no point; their sweeps are left out."
        yield Finding("MSG-312", "warning", topic.name, message)
    if role in FRAMED_ROLES and counts.frameless:
        message = (
            f"{counts.frameless} of {topic.count} messages name no frame (header.frame_id is empty): the sensor "
            "cannot be matched to the calibration. Set the frame in the driver."
        )
        yield Finding("TOP-115", "warning", topic.name, message)
    undated_ns = stamps_ns[np.abs(stamps_ns) < FIRST_DATE_NS]
    if len(undated_ns) == len(stamps_ns):  # such a clock counts from its start; only 0 is no time of it
        undated_ns = undated_ns[undated_ns == 0]
    if role in DATED_ROLES and len(undated_ns):
        message = (
            f"{len(undated_ns)} of {topic.count} messages are stamped near 1970-01-01 (the first "
            f"{undated_ns[0] / 1e9:.3f} s after it): the driver stamped before its clock was set."
        )
        yield Finding("TIM-211", "warning", topic.name, message)


def undated_finding(topic: Topic, role: Role, stamps_ns: NDArray[np.int64]) -> Iterator[Finding]:
    """Yield TIM-211 for a clock that counts from its start, if all others do so too, so that none is ahead."""
    set_ns = stamps_ns[stamps_ns != 0]
    if role in DATED_ROLES and len(set_ns) and np.abs(set_ns).max() < FIRST_DATE_NS:
        message = (
            f"Its stamps begin {int(set_ns[0]) / 1e9:.3f} s after 1970-01-01: its clock was never set, or time was "
            "simulated. Recordings of two such runs cannot be distinguished by time."
        )
        yield Finding("TIM-211", "warning", topic.name, message)
