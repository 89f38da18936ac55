"""Sampling of messages for quality measurements: the same instants from every topic.

**Conventions.** `at_ns` is log time since the recording's start. Instants divide the recording evenly. About 1 % of a
topic's messages are sampled, within the bounds of its kind: 16 to 32 of those that take milliseconds each, a few
hundred of the small ones. An invalid message is left out and counted, and a finding names its topic.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from stone.errors import StoneError
from stone.findings import Finding
from stone_recordings.bags.bag import Bag, RawMessage, Topic
from stone_recordings.report.inspection import Inspection
from stone_recordings.topics.profiles import channel_of_words
from stone_recordings.topics.roles import Role

# A power of two, so that the instants of fewer samples are among those of more.
INSTANTS = 512
SAMPLED_SHARE = 0.01
# Several topics of small messages, and the bytes that they may take: 16 MB.
MOST_KEPT, LONGEST_KEPT_BYTES = 4096, 4096


@dataclass(frozen=True)
class Effort:
    """The fewest and the most samples of a topic, powers of two up to `INSTANTS`."""

    least: int
    most: int


HEAVY, LIGHT, TINY = Effort(16, 32), Effort(128, 128), Effort(INSTANTS, INSTANTS)
# For a recording in place, however short: only its share is read, because raw pictures have megabytes each.
SPARING = Effort(1, 16)


@dataclass(frozen=True)
class TopicSampling:
    """`see` receives (at_ns, payload) of sampled messages of `topic`; it may refuse one by raising a StoneError.

    A payload is a view that is valid during the call; keeping it keeps its whole chunk in memory.
    """

    topic: Topic
    see: Callable[[int, memoryview], None]
    effort: Effort


@dataclass(frozen=True, eq=False)
class SampledMessages:
    """Reads messages of a recording and keeps copies of small ones, so that sampling a topic again inflates no chunk.

    With `is_sparing`, the number of samples that take milliseconds each is limited to a share of the recording.
    """

    bag: Bag
    is_sparing: bool = False
    _kept: dict[tuple[str, int], RawMessage] = field(default_factory=dict)

    def message(self, topic: str, index: int) -> RawMessage:
        """Return the message; raises the errors of `Bag.message`."""
        if (kept := self._kept.get((topic, index))) is not None:
            return kept
        read = self.bag.message(topic, index)
        if len(read.payload) > LONGEST_KEPT_BYTES or len(self._kept) >= MOST_KEPT:
            return read
        copied = RawMessage(read.log_time_ns, read.index, memoryview(bytes(read.payload)))
        self._kept[topic, index] = copied
        return copied


@dataclass(frozen=True)
class RecordingSpan:
    """Log times of the first and the last message of a recording; computed once, because it reads every topic."""

    start_ns: int
    length_ns: int


def span_of(bag: Bag) -> RecordingSpan:
    start_ns = bag.start_ns
    return RecordingSpan(start_ns, bag.end_ns - start_ns)


@dataclass
class _Refusals:
    """For one topic, the number of samples, and the refused ones by code, with the first sentence of each."""

    taken: int = 0
    counts: Counter[str] = field(default_factory=Counter)
    sentences: dict[str, str] = field(default_factory=dict)

    def add(self, error: StoneError | None) -> None:
        self.taken += 1
        if error is not None:
            self.counts[error.code] += 1
            self.sentences.setdefault(error.code, str(error))


def sample(bag: Bag, looks: Sequence[TopicSampling], sampled: SampledMessages | None = None) -> tuple[Finding, ...]:
    """Pass every look its samples, in log order; return one finding per topic and code for the refused ones.

    Messages that `sampled` holds are not read again.
    """
    span, messages = span_of(bag), sampled or SampledMessages(bag)
    looks = [replace(look, effort=SPARING) if messages.is_sparing and look.effort == HEAVY else look for look in looks]
    wanted = [_indices(bag, look, span) for look in looks]
    refusals = [_Refusals() for _ in looks]
    for instant in range(INSTANTS):
        for look, indices, refused in zip(looks, wanted, refusals, strict=True):
            if instant in indices:
                refused.add(_show(messages, look, indices[instant], span.start_ns))
    return tuple(_findings(looks, refusals))


def _indices(bag: Bag, look: TopicSampling, span: RecordingSpan) -> dict[int, int]:
    """Return the topic's message index by instant; no message twice, all messages of a short topic."""
    times_ns = bag.log_times_ns(look.topic.name)
    count = len(times_ns)
    if not count:
        return {}
    samples = _samples(count, look.effort)
    if count <= samples:
        return {index * INSTANTS // count: index for index in range(count)}
    instants = np.arange(INSTANTS // samples // 2, INSTANTS, INSTANTS // samples)
    asked_ns = span.start_ns + ((2 * instants + 1) * (max(1, span.length_ns) / (2 * INSTANTS))).astype(np.int64)
    nearest = np.minimum(np.searchsorted(times_ns, asked_ns), count - 1)
    _distinct, first = np.unique(nearest, return_index=True)
    return {int(instants[row]): int(nearest[row]) for row in first}


def _samples(count: int, effort: Effort) -> int:
    samples = effort.least
    while samples < min(effort.most, count * SAMPLED_SHARE):
        samples *= 2
    return samples


def _show(messages: SampledMessages, look: TopicSampling, index: int, start_ns: int) -> StoneError | None:
    """Return the reason why the message was refused, or None."""
    try:
        message = messages.message(look.topic.name, index)
        look.see(message.log_time_ns - start_ns, message.payload)
    except StoneError as error:
        return error
    return None


def _findings(looks: Sequence[TopicSampling], refusals: Sequence[_Refusals]) -> Iterator[Finding]:
    for look, refused in zip(looks, refusals, strict=True):
        is_lost = refused.counts.total() == refused.taken
        for code, count in sorted(refused.counts.items()):
            sentence = f"{count} of {refused.taken} sampled messages are left out: {refused.sentences[code]}"
            yield Finding(code, "error" if is_lost else "warning", look.topic.name, sentence)


# The topics whose quality is measured, and the names of the cameras. Roles are those of the inspection. The number is
# bounded: no robot has more, and thousands of declared cameras would take hours.


MOST_TOPICS_OF_A_ROLE = 12
CAMERA_RING = ("CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_LEFT", "CAM_BACK", "CAM_BACK_RIGHT")


def of_role(inspection: Inspection, *roles: Role) -> list[Topic]:
    """Return the first topics of these roles with decodable messages."""
    topics = [item.topic for item in inspection.topics if item.role in roles and item.topic.count]
    return [topic for topic in topics if topic.encoding == "cdr"][:MOST_TOPICS_OF_A_ROLE]


def cameras_of(inspection: Inspection) -> list[tuple[Topic, str]]:
    """Return topic and channel ("" if unnamed): front above back, left to right, then the others by name."""
    channel_of_topic = {
        topic: part for part, topic in inspection.assignment.channels.items() if part.startswith("CAM_")
    }
    named = [
        (topic, channel_of_topic.get(topic.name) or channel_of_words("camera", topic.name) or "")
        for topic in of_role(inspection, "camera")
    ]
    return sorted(named, key=lambda named_topic: (_place(named_topic[1]), named_topic[0].name))


def _place(channel: str) -> int:
    return CAMERA_RING.index(channel) if channel in CAMERA_RING else len(CAMERA_RING)
