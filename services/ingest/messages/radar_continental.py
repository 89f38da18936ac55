"""continental_msgs/msg/ContinentalArs548DetectionList, as Nebula publishes it: a sequence as long as the scan.

**Conventions.** The header stamp is the radar's or the packet's, by the driver's setting; the message does not say
which. Source: tier4/nebula, continental_msgs.
"""

from collections.abc import Iterable

from services.ingest.messages.batch import Stamped
from services.ingest.messages.radar_detections import RadarDetections, from_sequence
from services.ingest.messages.registry import resolved
from services.ingest.messages.table import STAMP, decode_table

TYPE = "continental_msgs/msg/ContinentalArs548DetectionList"
FIELDS = {
    "azimuth": "azimuth_angle", "elevation": "elevation_angle", "range": "range", "range_rate": "range_rate",
    "rcs": "rcs",
}  # fmt: skip
FLAGS = ("invalid_distance", "invalid_azimuth", "invalid_elevation", "invalid_range_rate")


def decode_continental(messages: Iterable[Stamped], schema: str = "") -> RadarDetections:
    """N = messages. Raises: MessageLayoutError, ByteOrderError, and what an unreadable `schema` raises."""
    only = (*STAMP, *(f"detections.{name}" for name in (*FIELDS.values(), *FLAGS)))
    table = decode_table(TYPE, messages, resolved(TYPE, schema).registry, only)
    return from_sequence(table, "detections", FIELDS, FLAGS)
