"""What the recordings that are to be joined hold: roles of their topics, and of topics that several hold, the messages.

**Conventions.** A message's digest is of its first `HEAD_BYTES` and its size, without the header's stamp: two of equal
digest and stamp are one message. Topics that only one recording holds are not read.
"""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from hashlib import blake2b

import numpy as np

from stone.sensors.shared_messages import TopicMessages
from stone_recordings.bags.bag import Bag
from stone_recordings.bags.errors import ByteOrderError, MessageLayoutError
from stone_recordings.bags.message_store import HEAD_BYTES
from stone_recordings.bags.topic import Topic
from stone_recordings.clocks.timing import begins_with_header, stamp_of
from stone_recordings.messages.types.cdr import HEAD_BYTES as ENCAPSULATION_BYTES
from stone_recordings.topics.profiles import Candidate
from stone_recordings.topics.roles import Role
from stone_recordings.topics.sources import candidate_of

STAMP = slice(ENCAPSULATION_BYTES, ENCAPSULATION_BYTES + 8)
SENSORS: frozenset[Role] = frozenset({"lidar", "camera", "radar", "gnss", "ins", "imu", "odometry", "pose"})


@dataclass(frozen=True, eq=False)
class HeldMessages:
    """One recording: its topics that have messages, and the messages of those that others hold, too."""

    name: str
    topics: tuple[Candidate, ...]
    messages: Mapping[str, TopicMessages]
    start_ns: int
    end_ns: int

    def of_role(self, *roles: Role) -> tuple[Candidate, ...]:
        return tuple(topic for topic in self.topics if topic.role in roles)

    @property
    def sensors(self) -> frozenset[str]:
        """The names of topics that sensors fill: whoever goes on with one of them goes on with the same run."""
        return frozenset(topic.name for topic in self.topics if topic.role in SENSORS)


def held_by(bags: Mapping[str, Bag]) -> tuple[HeldMessages, ...]:
    """By name, in order. Raises what reading heads and first clouds raises."""
    counts = Counter(topic.name for bag in bags.values() for topic in _readable(bag))
    shared = {name for name, count in counts.items() if count > 1}
    return tuple(_held(name, bag, shared) for name, bag in bags.items())


def _held(name: str, bag: Bag, shared: Collection[str]) -> HeldMessages:
    topics = _readable(bag)
    messages = _messages(bag, [topic for topic in topics if topic.name in shared])
    return HeldMessages(name, tuple(candidate_of(bag, topic) for topic in topics), messages, bag.start_ns, bag.end_ns)


def _readable(bag: Bag) -> list[Topic]:
    return [topic for topic in bag.topics if topic.count and topic.encoding == "cdr"]


def _messages(bag: Bag, topics: Sequence[Topic]) -> Mapping[str, TopicMessages]:
    logged = {topic.name: bag.log_times_ns(topic.name) for topic in topics}
    digests = {name: np.zeros(len(times), np.uint64) for name, times in logged.items()}
    stamps = {name: np.zeros(len(times), np.int64) for name, times in logged.items()}
    type_of = {topic.name: topic.type for topic in topics if begins_with_header(topic)}
    for name, index, payload in bag.heads([topic.name for topic in topics]):
        if name in type_of:
            stamps[name][index] = _stamp_ns(payload, type_of[name])
        digests[name][index] = _digest(payload, bag.size_bytes(name, index), name in type_of)
    return {name: TopicMessages(logged[name], stamps[name], digests[name]) for name in logged}


def _stamp_ns(payload: memoryview, type_name: str) -> int:
    """0 where there is none to be read."""
    try:
        return stamp_of(payload, type_name)
    except (MessageLayoutError, ByteOrderError):
        return 0


def _digest(payload: memoryview, size_bytes: int, has_header: bool) -> int:
    content = bytearray(payload[:HEAD_BYTES])
    if has_header:
        content[STAMP] = bytes(len(content[STAMP]))
    content += size_bytes.to_bytes(8, "little")
    return int.from_bytes(blake2b(content, digest_size=8).digest(), "little")
