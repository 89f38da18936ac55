"""Any supported radar message → detections, by the type of its topic.

**Conventions.** `stone_recordings.messages.radars.detections` defines the columns. Scan i is message i.
"""

from collections.abc import Callable, Iterable, Iterator
from itertools import islice

from stone_recordings.bags.errors import DefinitionMissingError
from stone_recordings.messages.batch import StampedMessage
from stone_recordings.messages.compressed_cloud import plain_cloud
from stone_recordings.messages.lidars.models import COMPRESSED_CLOUD
from stone_recordings.messages.radars import ars548, cloud, continental, packets, scan
from stone_recordings.messages.radars.detections import RadarDetections, joined

__all__ = ["RADAR_TYPES", "RadarDetections", "decode_radar"]

_DECODERS: dict[str, Callable[[Iterable[StampedMessage], str], RadarDetections]] = {
    ars548.TYPE: ars548.decode_ars548,
    continental.TYPE: continental.decode_continental,
    scan.TYPE: scan.decode_radar_scan,
    packets.TYPE: packets.decode_packets,
    cloud.TYPE: lambda messages, _schema: cloud.decode_radar_cloud(messages),
    COMPRESSED_CLOUD: lambda messages, _schema: cloud.decode_radar_cloud(messages, plain_cloud),
}
# An ARS 548 list has 41,741 bytes, so this is about 21 MB.
_PORTION = 512
RADAR_TYPES = frozenset(_DECODERS)


def decode_radar(topic_type: str, messages: Iterable[StampedMessage], schema: str = "") -> RadarDetections:
    """Decode a topic; `schema` is the embedded definition, "" for none.

    Raises: DefinitionMissingError (no radar type), MessageLayoutError, ByteOrderError, CloudLayoutError, `MSG-308`.
    """
    if topic_type not in _DECODERS:
        raise DefinitionMissingError(topic_type, tuple(sorted(RADAR_TYPES)))
    decode = _DECODERS[topic_type]
    return joined([decode(some, schema) for some in _portions(messages)])


def _portions(messages: Iterable[StampedMessage]) -> Iterator[list[StampedMessage]]:
    """Yield portions that bound the memory of a reader that inflates chunks; an empty portion without messages."""
    remaining = iter(messages)
    yield list(islice(remaining, _PORTION))
    while some := list(islice(remaining, _PORTION)):
        yield some
