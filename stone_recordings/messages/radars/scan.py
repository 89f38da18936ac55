"""radar_msgs/msg/RadarScan: returns of any radar, in the common words of ROS.

**Conventions.** `amplitude` (dB) is given as `rcs_db`: the message has no other measure of strength. Source:
radar_msgs (branch ros2), REP 103 for the signs of angles.
"""

from collections.abc import Iterable

from stone_recordings.messages.batch import StampedMessage
from stone_recordings.messages.radars.detections import RadarDetections, from_sequence
from stone_recordings.messages.types.registry import resolved
from stone_recordings.messages.types.table import decode_table

TYPE = "radar_msgs/msg/RadarScan"
FIELDS = {
    "azimuth": "azimuth", "elevation": "elevation", "range": "range", "range_rate": "doppler_velocity",
    "rcs": "amplitude",
}  # fmt: skip


def decode_radar_scan(messages: Iterable[StampedMessage], schema: str = "") -> RadarDetections:
    """Decode N messages; a return is valid if it is finite. Raises: MessageLayoutError, ByteOrderError."""
    table = decode_table(TYPE, messages, resolved(TYPE, schema).registry)
    return from_sequence(table, "returns", FIELDS)
