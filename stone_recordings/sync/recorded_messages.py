"""The messages that synchronisation reads in one pass: header stamps, and small messages whole.

**Conventions.** The pass takes all topics together, so that a compressed recording is inflated once. What is kept is
copied: a view would keep its whole chunk alive. Stamps are those of the messages' headers.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone_recordings.bags.bag import Bag, Topic
from stone_recordings.bags.errors import ByteOrderError, MessageLayoutError
from stone_recordings.messages.lidars.models import COMPRESSED_CLOUD, LIVOX_TYPES
from stone_recordings.messages.problems import (
    DAMAGED,
    MALFORMED,
    MessageProblem,
    TopicHeads,
    left_out_finding,
    majority,
)
from stone_recordings.messages.sweep_clouds import CLOUD_TYPES, SWEEP_TYPES, points_declared, sweep_problem
from stone_recordings.messages.types.cdr import HEAD_BYTES, NS_PER_S, Cursor
from stone_recordings.topics.sources import Sources

STAMP_BYTES = HEAD_BYTES + 8
# A header with the longest frame_id anybody uses; of a cloud also its fields.
HEADER_BYTES, CLOUD_HEAD_BYTES = 256, 2048
# Whether points inflate, and how long those of a ROS 1 bag are as CDR, only the whole message tells.
TOLD_WHOLE = LIVOX_TYPES | {COMPRESSED_CLOUD}
NO_PROBLEMS: Mapping[int, MessageProblem] = {}


@dataclass(frozen=True, slots=True)
class OwnMessage:
    """A payload that holds nothing else alive."""

    payload: memoryview


@dataclass(frozen=True, eq=False)
class RecordedTopics:
    """`heads`: the first bytes of every message of a scanned topic; `messages`: whole small messages of others.

    `problems`: of a scanned topic, the numbers of the messages that cannot be used, and why; `log_times_ns` of all.
    Of `messages` those that lie in damaged chunks are missing. `sources` are what was read for.
    """

    topics: Mapping[str, Topic]
    heads: Mapping[str, list[bytes]] = field(default_factory=dict)
    messages: Mapping[str, list[OwnMessage]] = field(default_factory=dict)
    problems: Mapping[str, Mapping[int, MessageProblem]] = field(default_factory=dict)
    log_times_ns: Mapping[str, NDArray[np.int64]] = field(default_factory=dict)
    sources: Sources | None = None

    def stamps_ns(self, topic: str) -> NDArray[np.int64]:
        """Header stamps (N,) of a scanned topic in log-time order; the log time where a message has none."""
        type_name, heads, stamps_ns = self.topics[topic].type, self.heads[topic], self.log_times_ns[topic].copy()
        usable = self.usable(topic)
        raw = np.frombuffer(b"".join(heads[index][HEAD_BYTES:STAMP_BYTES] for index in usable), "<u4").reshape(-1, 2)
        stamps_ns[usable] = raw[:, 0].astype(np.int32).astype(np.int64) * NS_PER_S + raw[:, 1]
        for index in self.problems.get(topic, NO_PROBLEMS):
            with suppress(MessageLayoutError, ByteOrderError):
                stamps_ns[index] = Cursor(memoryview(heads[index]), type_name).stamp_ns() or stamps_ns[index]
        return stamps_ns

    def usable(self, topic: str) -> NDArray[np.int64]:
        """The numbers (M,) of a scanned topic's messages that nothing is wrong with."""
        is_usable = np.ones(len(self.heads[topic]), np.bool_)
        is_usable[list(self.problems.get(topic, NO_PROBLEMS))] = False
        return np.flatnonzero(is_usable)

    def frame_ids(self, topic: str) -> list[str]:
        """`frame_id` of each message of a topic of clouds that nothing is wrong with."""
        found = []
        for index in self.usable(topic).tolist():
            cursor = Cursor(memoryview(self.heads[topic][index]), self.topics[topic].type)
            cursor.stamp_ns()
            found.append(cursor.text())
        return found

    def frame_id(self, topic: str) -> str:
        """The `frame_id` of most of a topic's clouds, of another topic's first message; "" without."""
        if self.topics[topic].type in SWEEP_TYPES:
            return majority(self.frame_ids(topic))
        usable = self.usable(topic)
        if not len(usable):
            return ""
        cursor = Cursor(memoryview(self.heads[topic][int(usable[0])]), self.topics[topic].type)
        cursor.stamp_ns()
        return cursor.text()

    def cloud_size(self, topic: str, index: int) -> int:
        """Declared points of a cloud that nothing is wrong with, or the packets that take its place."""
        return points_declared(memoryview(self.heads[topic][index]), self.topics[topic].type) or 0

    def left_out(self, topic: str) -> tuple[Finding, ...]:
        """What is said of a topic's messages that cannot be used."""
        problems = self.problems.get(topic, NO_PROBLEMS)
        return left_out_finding(topic, problems, self.stamps_ns(topic)) if problems else ()


@dataclass(frozen=True, eq=False)
class OrderedStamps:
    """`index` (M,) into what was recorded gives strictly increasing `stamps_ns` (M,)."""

    index: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    findings: tuple[Finding, ...]


class RecordedReading:
    """Takes what a pass over the heads of a recording yields, for whoever makes one; of `whole` topics whole messages.

    Messages of topics that are not `used` are passed over.
    """

    def __init__(self, bag: Bag, sources: Sources) -> None:
        self._bag, self._sources = bag, sources
        self.used = tuple(dict.fromkeys((*sources.scanned, *sources.whole)))
        self._topics = {topic.name: topic for topic in bag.topics}
        told_late = (name for name in sources.scanned if self._topics[name].type in TOLD_WHOLE)
        self.whole = (*sources.whole, *told_late)
        radars = {topic.name for topic, role in sources.associated if role == "radar" and topic.type in CLOUD_TYPES}
        self._placed = {sources.lidar.name, *radars}  # whose points need places
        self._heads = {name: [b""] * self._topics[name].count for name in sources.scanned}
        self._payloads: dict[str, dict[int, bytes]] = {name: {} for name in sources.whole}
        self._unusable: dict[str, dict[int, MessageProblem]] = {name: {} for name in sources.scanned}
        self._read = {name: TopicHeads(self._topics[name].type) for name in sources.scanned}

    def take(self, name: str, index: int, payload: memoryview) -> None:
        """A message in the order of `Bag.heads`, which has just yielded it."""
        if name in self._payloads:
            self._payloads[name][index] = bytes(payload)
        if name in self._heads:
            most = CLOUD_HEAD_BYTES if name == self._sources.lidar.name else HEADER_BYTES
            self._heads[name][index] = bytes(payload[:most])
            problem = self._problem(name, index, payload)
            if problem is not None:
                self._unusable[name][index] = problem

    def finished(self) -> RecordedTopics:
        """What was taken, after all of it."""
        damaged = {name: self._bag.damaged.get(name, {}) for name in self._heads}
        problems = {
            name: {**{index: MessageProblem(DAMAGED, why) for index, why in damaged[name].items()}, **unusable}
            for name, unusable in self._unusable.items()
        }
        messages = {
            name: [OwnMessage(memoryview(own[index])) for index in sorted(own)] for name, own in self._payloads.items()
        }
        times_ns = {name: self._bag.log_times_ns(name) for name in self._heads}
        return RecordedTopics(self._topics, self._heads, messages, problems, times_ns, self._sources)

    def _problem(self, name: str, index: int, payload: memoryview) -> MessageProblem | None:
        type_name = self._topics[name].type
        problem = self._read[name].problem(payload, partial(self._bag.size_bytes, name, index))
        if problem is None and name in self._placed and (missing := sweep_problem(payload, type_name)):
            return MessageProblem(MALFORMED, missing)
        return problem


def read_recorded(bag: Bag, sources: Sources) -> RecordedTopics:
    """One pass over the topics that are used. Raises what `Bag.heads` raises."""
    reading = RecordedReading(bag, sources)
    for name, index, payload in bag.heads(reading.used, whole=reading.whole, is_checked=True):
        reading.take(name, index, payload)
    return reading.finished()


def in_order(topic: str, stamps_ns: NDArray[np.int64], rows: NDArray[np.int64] | None = None) -> OrderedStamps:
    """Stamps sorted (stably) with repeats dropped, the first kept; both are said in findings, with the worst step.

    `rows` (M,) are the messages that count, where not all do.
    """
    rows = np.arange(len(stamps_ns), dtype=np.int64) if rows is None else rows
    stamps_ns = stamps_ns[rows]
    order = np.argsort(stamps_ns, kind="stable").astype(np.int64)
    is_new = np.ones(len(order), np.bool_)
    is_new[1:] = np.diff(stamps_ns[order]) > 0
    steps_ns = np.diff(stamps_ns)
    back, repeats = int((steps_ns < 0).sum()), int((~is_new).sum())
    findings: list[Finding] = []
    if back:
        sentence = f"{back} stamps go backwards (worst {int(steps_ns.min()) / 1e6:.3f} ms); they were sorted"
        findings.append(Finding("TIM-203", "warning", topic, sentence))
    if repeats:
        findings.append(Finding("TIM-206", "warning", topic, f"{repeats} messages repeat a stamp; the first is used"))
    return OrderedStamps(rows[order[is_new]], stamps_ns[order[is_new]], tuple(findings))
