"""The findings of an inspection, each measured here and with its figure.

**Conventions.** `BAG-*` is about the container, `TOP-*` about topics, `TIM-*` about clocks. Nothing is repaired: a
finding states the effect on later stages, or what to change before the next recording.
"""

from collections.abc import Iterator
from contextlib import suppress

import numpy as np

from stone.findings import Finding
from stone_recordings.bags.bag import Bag, Topic
from stone_recordings.bags.errors import IngestError
from stone_recordings.clocks.point_clock import looks_of
from stone_recordings.clocks.sweep_findings import sweep_findings
from stone_recordings.clocks.timing import Timing
from stone_recordings.messages.camera import decode_image
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


def picture_findings(bag: Bag, topic: Topic) -> Iterator[Finding]:
    """Yield findings if the declaration of a topic's middle image contradicts its bytes."""
    with suppress(IngestError):
        picture = decode_image(bag.message(topic.name, topic.count // 2).payload, topic.type)
        if picture.ignored:
            message = f"Its images contradict their own data, which is read ({picture.ignored}). Correct the driver."
            yield Finding("MSG-320", "warning", topic.name, message)


def cloud_findings(bag: Bag, topic: Topic) -> Iterator[Finding]:
    """Yield findings about a few clouds of a LiDAR topic, from beginning to end."""
    yield from sweep_findings(bag, topic.name, looks_of(bag, topic.name, np.arange(topic.count)))
