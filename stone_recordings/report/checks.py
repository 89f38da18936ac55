"""The findings of an inspection: each one measured here, each with the number that made it.

**Conventions.** `BAG-*` the container, `TOP-*` which topics there are, `TIM-*` their clocks. Nothing is repaired: a
finding says what later stages will do about it, or what to change before the next recording.
"""

from collections.abc import Iterator

from stone.findings import Finding
from stone_recordings.bags.bag import Bag, Topic
from stone_recordings.clocks.timing import Timing
from stone_recordings.messages.pointcloud2 import Cloud, lidar_points
from stone_recordings.topics.roles import Role

Inspected = tuple[Topic, Role, Timing]


def container_findings(bag: Bag) -> Iterator[Finding]:
    yield from bag.findings
    yield from bag.damage_findings
    if not bag.is_indexed:
        yield Finding(
            "BAG-011",
            "info",
            "",
            "No usable index: the whole file was scanned. Record without `fastwrite`, or close the bag, to avoid it.",
        )
    for topic in bag.topics:
        if topic.encoding != "cdr":
            message = f"Encoded as {topic.encoding!r}, only 'cdr' is read: this topic is left out."
            yield Finding("BAG-014", "warning", topic.name, message)


def cloud_findings(topic: Topic, cloud: Cloud) -> Iterator[Finding]:
    """One cloud of a LiDAR topic, looked at in full."""
    if cloud.is_misdeclared:
        message = "Declared big-endian, its points are little-endian: they are read as such. Correct the driver's flag."
        yield Finding("MSG-303", "warning", topic.name, message)
    points = lidar_points(cloud)
    if points.offset_ns is None and points.time_meaning == "another clock":
        message = "Point times are on another clock than the header stamp: sweeps are not deskewed."
        yield Finding("TOP-102", "warning", topic.name, message)
    elif points.offset_ns is None:
        message = "The points have no time: sweeps are not deskewed, and a turning robot smears them."
        yield Finding("TOP-102", "warning", topic.name, message)
