"""One cloud of a topic that shows what the topic is: from its middle, or from elsewhere where that one is bad."""

from collections.abc import Iterator

from stone_recordings.bags.bag import Bag, Topic
from stone_recordings.bags.errors import CloudLayoutError, IngestError
from stone_recordings.messages.pointcloud2 import Cloud, decode_cloud

TRIES = 8


def sample_cloud(bag: Bag, topic: Topic) -> Cloud:
    """The first of a few clouds, from the middle on, that can be decoded and has points; else one without.

    Raises what decoding the first of them raises, where none can be.
    """
    empty: Cloud | None = None
    refusal: IngestError = CloudLayoutError("the topic has no message")
    for number, index in enumerate(_places(topic.count)):
        try:
            cloud = decode_cloud(bag.message(topic.name, index).payload)
        except IngestError as error:
            refusal = refusal if number else error
            continue
        if len(cloud.points):
            return cloud
        empty = empty or cloud
    if empty is None:
        raise refusal
    return empty


def _places(count: int) -> Iterator[int]:
    """The middle, then others spread over the topic, each once."""
    middle = count // 2
    yield from dict.fromkeys((middle, *((middle + 1 + part * count // TRIES) % count for part in range(TRIES))))
