"""Recordings that share a clock, found by their common messages and topics.

**Conventions.** Common messages give the offset exactly: by their stamps if these differ by a constant (a file was
shifted), else by their log times, with the scatter of transport. If one recording continues the sensors' topics of
another after its end, the recorder split the run: they share a clock.
"""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from hashlib import blake2b

import numpy as np

from stone.sensors.shared_messages import SharedMessages, TopicMessages, repeated_rows, runs_of, shared_messages
from stone_files.joined_file import SAME_MESSAGES, SAME_TOPICS
from stone_recordings.bags.bag import Bag
from stone_recordings.bags.errors import ByteOrderError, MessageLayoutError
from stone_recordings.bags.message_store import HEAD_BYTES, Topic
from stone_recordings.clocks.timing import begins_with_header, stamp_of
from stone_recordings.messages.types.cdr import HEAD_BYTES as ENCAPSULATION_BYTES
from stone_recordings.topics.profiles import Candidate
from stone_recordings.topics.roles import Role
from stone_recordings.topics.sources import candidate_of

# The content of the recordings to join: roles of their topics, and the messages of common topics. A message's digest is
# of its first `HEAD_BYTES` and its size, without the header's stamp: two messages with equal digest and stamp are one.
# Topics of only one recording are not read.


STAMP = slice(ENCAPSULATION_BYTES, ENCAPSULATION_BYTES + 8)
SENSORS: frozenset[Role] = frozenset({"lidar", "camera", "radar", "gnss", "ins", "imu", "odometry", "pose"})


@dataclass(frozen=True, eq=False)
class HeldMessages:
    """One recording: its topics with messages, and the messages of topics that others also have."""

    name: str
    topics: tuple[Candidate, ...]
    messages: Mapping[str, TopicMessages]
    start_ns: int
    end_ns: int

    def of_role(self, *roles: Role) -> tuple[Candidate, ...]:
        return tuple(topic for topic in self.topics if topic.role in roles)

    @property
    def sensors(self) -> frozenset[str]:
        """The names of sensors' topics: a recording that continues one of them continues the same run."""
        return frozenset(topic.name for topic in self.topics if topic.role in SENSORS)


def held_by(bags: Mapping[str, Bag]) -> tuple[HeldMessages, ...]:
    """Return the content by name, in order. Raises the errors of reading heads and first clouds."""
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
    """Return the stamp, or 0 if there is none."""
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


# Two recorders of one host log a message this far apart; a smaller difference is no clock offset.
TRANSPORT_NS = 1_000_000


@dataclass(frozen=True)
class ClockOffset:
    """The offset that moves a recording's times to another's clock. `sigma_ns` and the rest as in `JoinedMember`."""

    offset_ns: int
    sigma_ns: int | None
    known_by: tuple[str, ...]
    kept_topics: tuple[str, ...] = ()

    def reversed(self) -> "ClockOffset":
        return ClockOffset(-self.offset_ns, self.sigma_ns, self.known_by, self.kept_topics)

    def after(self, other: "ClockOffset") -> "ClockOffset":
        """Return this offset chained with `other`, the offset of the recording that it refers to."""
        sigmas = (self.sigma_ns or 0, other.sigma_ns or 0)
        known_by = tuple(dict.fromkeys((*other.known_by, *self.known_by)))
        kept = self.kept_topics if not other.offset_ns else ()
        return ClockOffset(self.offset_ns + other.offset_ns, round(sum(s**2 for s in sigmas) ** 0.5), known_by, kept)


def linked(held: Sequence[HeldMessages], start: int) -> Mapping[int, ClockOffset]:
    """Return the recordings linked to `start` by messages or topics, with their offsets; `start` is among them."""
    offsets = {start: ClockOffset(0, 0, ())}
    waiting = [start]
    while waiting:
        at = waiting.pop(0)
        for other in range(len(held)):
            link = None if other in offsets else link_between(held[at], held[other])
            if link is not None:
                offsets[other] = link.after(offsets[at])
                waiting.append(other)
    return offsets


def link_between(first: HeldMessages, second: HeldMessages) -> ClockOffset | None:
    """Return the offset of the second's times to the first's clock; None if they share too little."""
    topics = [name for name in first.messages if name in second.messages]
    pairs = {name: shared_messages(first.messages[name], second.messages[name]) for name in topics}
    shared_by_topic = {name: shared for name, shared in pairs.items() if shared is not None}
    if shared_by_topic:
        return _by_messages(shared_by_topic)
    goes_on = first.sensors & second.sensors & set(topics)
    if goes_on and all(_is_apart(first.messages[name], second.messages[name]) for name in goes_on):
        return ClockOffset(0, None, (SAME_TOPICS,))
    return None


def _by_messages(shared_by_topic: Mapping[str, SharedMessages]) -> ClockOffset:
    """Return the offset by the topic with the most messages."""
    best = max(shared_by_topic.values(), key=lambda shared: shared.count)
    if best.stamp_offset_ns:
        return ClockOffset(best.stamp_offset_ns, 0, (SAME_MESSAGES,))
    if abs(best.log_offset_ns) < TRANSPORT_NS:
        return ClockOffset(0, 0, (SAME_MESSAGES,))
    kept = tuple(sorted(name for name, shared in shared_by_topic.items() if shared.stamp_offset_ns == 0))
    return ClockOffset(best.log_offset_ns, best.spread_ns, (SAME_MESSAGES,), kept)


def _is_apart(first: TopicMessages, second: TopicMessages) -> bool:
    """Return whether one ends before the other starts, by their log times."""
    first_ns, two = first.log_times_ns, second.log_times_ns
    return bool(first_ns[-1] < two[0] or two[-1] < first_ns[0])


# Messages that two recordings of a run both contain, on a common clock: the copies to leave out. The earlier of the
# members keeps a message. Indices are those of the recording itself.


Runs = Mapping[str, tuple[tuple[int, int], ...]]


def left_out(held: Sequence[HeldMessages], offsets: Sequence[ClockOffset]) -> tuple[Runs, ...]:
    """Return for each recording, by topic, the runs of messages that an earlier recording also contains."""
    moved = [
        {name: _moved(messages, offset, name) for name, messages in recording.messages.items()}
        for recording, offset in zip(held, offsets, strict=True)
    ]
    return tuple(_repeated(moved[:number], moved[number], offsets[number]) for number in range(len(held)))


def _repeated(
    before: Sequence[Mapping[str, TopicMessages]], own: Mapping[str, TopicMessages], offset: ClockOffset
) -> Runs:
    tolerance_ns = max(TRANSPORT_NS, 5 * (offset.sigma_ns or 0))
    repeated = {}
    for name, messages in own.items():
        rows = [repeated_rows(other[name], messages, tolerance_ns) for other in before if name in other]
        if runs := runs_of(np.unique(np.concatenate(rows)) if rows else np.zeros(0, np.int64)):
            repeated[name] = runs
    return repeated


def _moved(messages: TopicMessages, offset: ClockOffset, name: str) -> TopicMessages:
    has_stamp = (messages.stamps_ns != 0) & (name not in offset.kept_topics)
    stamps_ns = messages.stamps_ns + np.where(has_stamp, offset.offset_ns, 0)
    return TopicMessages(messages.log_times_ns + offset.offset_ns, stamps_ns, messages.digests)
