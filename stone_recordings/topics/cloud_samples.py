"""One cloud that represents a topic: its middle cloud, or another cloud if the middle one is unusable."""

from collections.abc import Iterator

from stone.findings import Finding
from stone_recordings.bags.bag import Bag, Topic
from stone_recordings.bags.errors import CloudLayoutError, IngestError
from stone_recordings.messages.pointcloud2 import Cloud
from stone_recordings.messages.sweep_clouds import PACKET_TYPES, cloud_at, packet_cloud

TRIES = 8


def sample_cloud(bag: Bag, topic: Topic) -> Cloud:
    """Return the first of a few clouds, from the middle on, that can be decoded and has points; else one without
    points.

    Raises the error of the first cloud if none can be decoded.
    """
    empty: Cloud | None = None
    refusal: IngestError = CloudLayoutError("the topic has no message")
    for number, index in enumerate(_places(topic.count)):
        try:
            cloud = cloud_at(bag, topic.name, index)
        except IngestError as error:
            refusal = refusal if number else error
            continue
        if len(cloud.points):
            return cloud
        empty = empty or cloud
    if empty is None:
        raise refusal
    return empty


def packet_findings(bag: Bag, topic: Topic) -> tuple[Finding, ...]:
    """Return TOP-116 if sweeps are decoded from packets: the source of the angles, and the packets left out."""
    if topic.type not in PACKET_TYPES:
        return ()
    for index in _places(topic.count):
        try:
            cloud = packet_cloud(bag.message(topic.name, index).payload, topic.type)
        except IngestError:
            continue
        lost = (
            f"; {cloud.left_out} of {cloud.packets} packets of a sweep are not of this model" if cloud.left_out else ""
        )
        sentence = (
            f"Its packets are decoded as those of a {cloud.model} with the maker's default angles. The unit's own "
            "angles, "
            f"which differ by tenths of a degree, are not in the packets. Record the driver's points to use them{lost}."
        )
        return (Finding("TOP-116", "warning" if lost else "info", topic.name, sentence),)
    return ()


def _places(count: int) -> Iterator[int]:
    """Yield the middle index, then others spread over the topic, each once."""
    middle = count // 2
    yield from dict.fromkeys((middle, *((middle + 1 + part * count // TRIES) % count for part in range(TRIES))))
