"""Any radar message that is understood → detections, by the type of its topic.

**Conventions.** `services.ingest.messages.radar_detections` says what the columns mean. Scan i is message i.
"""

from collections.abc import Callable, Iterable, Iterator
from itertools import islice

from services.ingest.errors import DefinitionMissingError
from services.ingest.messages import radar_ars548, radar_cloud, radar_continental, radar_packets, radar_scan
from services.ingest.messages.batch import Stamped
from services.ingest.messages.radar_detections import RadarDetections, joined

__all__ = ["RADAR_TYPES", "RadarDetections", "decode_radar"]

_DECODERS: dict[str, Callable[[Iterable[Stamped], str], RadarDetections]] = {
    radar_ars548.TYPE: radar_ars548.decode_ars548,
    radar_continental.TYPE: radar_continental.decode_continental,
    radar_scan.TYPE: radar_scan.decode_radar_scan,
    radar_packets.TYPE: radar_packets.decode_packets,
    radar_cloud.TYPE: lambda messages, _schema: radar_cloud.decode_radar_cloud(messages),
}
# An ARS 548 list has 41,741 bytes, so this is some 21 MB.
_PORTION = 512
RADAR_TYPES = frozenset(_DECODERS)


def decode_radar(topic_type: str, messages: Iterable[Stamped], schema: str = "") -> RadarDetections:
    """`schema` is the definition that the recording embeds, "" for none.

    Raises: DefinitionMissingError (no radar type), MessageLayoutError, ByteOrderError, CloudLayoutError, PacketError.
    """
    if topic_type not in _DECODERS:
        raise DefinitionMissingError(topic_type, tuple(sorted(RADAR_TYPES)))
    decode = _DECODERS[topic_type]
    return joined([decode(some, schema) for some in _portions(messages)])


def _portions(messages: Iterable[Stamped]) -> Iterator[list[Stamped]]:
    """So many at once that whoever inflates chunks to get at them need not keep them all; an empty one where there
    are none."""
    remaining = iter(messages)
    yield list(islice(remaining, _PORTION))
    while some := list(islice(remaining, _PORTION)):
        yield some
