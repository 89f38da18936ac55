"""continental_msgs/msg/ContinentalArs548DetectionList, as published by Nebula: a sequence as long as the scan.

**Conventions.** The header stamp is the radar's or the packet's, depending on a setting of the driver that the message
does not contain. Source: tier4/nebula, continental_msgs.
"""

from collections.abc import Iterable

from stone_recordings.messages.batch import StampedMessage
from stone_recordings.messages.radars.detections import RadarDetections, from_sequence
from stone_recordings.messages.types.registry import resolved
from stone_recordings.messages.types.table import STAMP, decode_table

TYPE = "continental_msgs/msg/ContinentalArs548DetectionList"
FIELDS = {
    "azimuth": "azimuth_angle", "elevation": "elevation_angle", "range": "range", "range_rate": "range_rate",
    "rcs": "rcs",
}  # fmt: skip
FLAGS = ("invalid_distance", "invalid_azimuth", "invalid_elevation", "invalid_range_rate")


def decode_continental(messages: Iterable[StampedMessage], schema: str = "") -> RadarDetections:
    """Decode N messages. Raises: MessageLayoutError, ByteOrderError, and the errors of an unreadable `schema`."""
    only = (*STAMP, *(f"detections.{name}" for name in (*FIELDS.values(), *FLAGS)))
    table = decode_table(TYPE, messages, resolved(TYPE, schema).registry, only)
    return from_sequence(table, "detections", FIELDS, FLAGS)
