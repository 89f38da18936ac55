"""The messages that synchronisation reads in one pass: header stamps, and small messages whole.

**Conventions.** The pass takes all topics together, so that a compressed recording is inflated once. Kept bytes are
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
# A header with the longest frame_id in use; for a cloud also its fields.
HEADER_BYTES, CLOUD_HEAD_BYTES = 256, 2048
# Only the whole message shows whether points inflate, and how long those of a ROS 1 bag are as CDR.
TOLD_WHOLE = LIVOX_TYPES | {COMPRESSED_CLOUD}
NO_PROBLEMS: Mapping[int, MessageProblem] = {}


@dataclass(frozen=True, slots=True)
class OwnMessage:
    """A payload that holds nothing else alive."""

    payload: memoryview


@dataclass(frozen=True, eq=False)
class RecordedTopics:
    """`heads`: the first bytes of every message of a scanned topic; `messages`: whole small messages of others.

    `problems` maps the numbers of unusable messages of a scanned topic to the reason; `log_times_ns` are of all
    messages. `messages` lacks those in damaged chunks. `sources` are the topics that were read.
    """

    topics: Mapping[str, Topic]
    heads: Mapping[str, list[bytes]] = field(default_factory=dict)
    messages: Mapping[str, list[OwnMessage]] = field(default_factory=dict)
    problems: Mapping[str, Mapping[int, MessageProblem]] = field(default_factory=dict)
    log_times_ns: Mapping[str, NDArray[np.int64]] = field(default_factory=dict)
    sources: Sources | None = None

    def stamps_ns(self, topic: str) -> NDArray[np.int64]:
        """Return the header stamps (N,) of a scanned topic in log-time order; the log time if a message has no
        stamp.
        """
        type_name, heads, stamps_ns = self.topics[topic].type, self.heads[topic], self.log_times_ns[topic].copy()
        usable = self.usable(topic)
        raw = np.frombuffer(b"".join(heads[index][HEAD_BYTES:STAMP_BYTES] for index in usable), "<u4").reshape(-1, 2)
        stamps_ns[usable] = raw[:, 0].astype(np.int32).astype(np.int64) * NS_PER_S + raw[:, 1]
        for index in self.problems.get(topic, NO_PROBLEMS):
            with suppress(MessageLayoutError, ByteOrderError):
                stamps_ns[index] = Cursor(memoryview(heads[index]), type_name).stamp_ns() or stamps_ns[index]
        return stamps_ns

    def usable(self, topic: str) -> NDArray[np.int64]:
        """Return the numbers (M,) of a scanned topic's usable messages."""
        is_usable = np.ones(len(self.heads[topic]), np.bool_)
        is_usable[list(self.problems.get(topic, NO_PROBLEMS))] = False
        return np.flatnonzero(is_usable)

    def frame_ids(self, topic: str) -> list[str]:
        """Return `frame_id` of each usable message of a topic of clouds."""
        names = []
        for index in self.usable(topic).tolist():
            cursor = Cursor(memoryview(self.heads[topic][index]), self.topics[topic].type)
            cursor.stamp_ns()
            names.append(cursor.text())
        return names

    def frame_id(self, topic: str) -> str:
        """Return the most frequent `frame_id` of a topic's clouds, or that of another topic's first message; "" without
        any.
        """
        if self.topics[topic].type in SWEEP_TYPES:
            return majority(self.frame_ids(topic))
        usable = self.usable(topic)
        if not len(usable):
            return ""
        cursor = Cursor(memoryview(self.heads[topic][int(usable[0])]), self.topics[topic].type)
        cursor.stamp_ns()
        return cursor.text()

    def cloud_size(self, topic: str, index: int) -> int:
        """Return the declared number of points of a usable cloud, or the number of packets that take its place."""
        return points_declared(memoryview(self.heads[topic][index]), self.topics[topic].type) or 0

    def left_out(self, topic: str) -> tuple[Finding, ...]:
        """Return the findings about a topic's unusable messages."""
        problems = self.problems.get(topic, NO_PROBLEMS)
        return left_out_finding(topic, problems, self.stamps_ns(topic)) if problems else ()


@dataclass(frozen=True, eq=False)
class OrderedStamps:
    """`index` (M,) into the recorded messages gives strictly increasing `stamps_ns` (M,)."""

    index: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    findings: tuple[Finding, ...]


class RecordedReading:
    """Collects the messages of a pass over the heads of a recording; messages of `whole` topics are kept whole.

    Messages of topics that are not `used` are skipped.
    """

    def __init__(self, bag: Bag, sources: Sources) -> None:
        self._bag, self._sources = bag, sources
        self.used = tuple(dict.fromkeys((*sources.scanned, *sources.whole)))
        self._topics = {topic.name: topic for topic in bag.topics}
        told_late = (name for name in sources.scanned if self._topics[name].type in TOLD_WHOLE)
        self.whole = (*sources.whole, *told_late)
        radars = {topic.name for topic, role in sources.associated if role == "radar" and topic.type in CLOUD_TYPES}
        self._placed = {sources.lidar.name, *radars}  # topics whose points need a position
        self._heads = {name: [b""] * self._topics[name].count for name in sources.scanned}
        self._payloads: dict[str, dict[int, bytes]] = {name: {} for name in sources.whole}
        self._unusable: dict[str, dict[int, MessageProblem]] = {name: {} for name in sources.scanned}
        self._read = {name: TopicHeads(self._topics[name].type) for name in sources.scanned}

    def take(self, name: str, index: int, payload: memoryview) -> None:
        """Take a message in the order of `Bag.heads`, which has just yielded it."""
        if name in self._payloads:
            self._payloads[name][index] = bytes(payload)
        if name in self._heads:
            most = CLOUD_HEAD_BYTES if name == self._sources.lidar.name else HEADER_BYTES
            self._heads[name][index] = bytes(payload[:most])
            problem = self._problem(name, index, payload)
            if problem is not None:
                self._unusable[name][index] = problem

    def finished(self) -> RecordedTopics:
        """Return the collected messages after the pass."""
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
    """Read the used topics in one pass. Raises the errors of `Bag.heads`."""
    reading = RecordedReading(bag, sources)
    for name, index, payload in bag.heads(reading.used, whole=reading.whole, is_checked=True):
        reading.take(name, index, payload)
    return reading.finished()


def in_order(topic: str, stamps_ns: NDArray[np.int64], rows: NDArray[np.int64] | None = None) -> OrderedStamps:
    """Return the stamps sorted (stably) without repeats, the first kept; findings report both, with the worst step.

    `rows` (M,) selects the messages that count; the default is all.
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
