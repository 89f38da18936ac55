"""The messages that synchronisation reads in one pass: header stamps, and small messages whole.

**Conventions.** The pass takes all topics together, so that a compressed recording is inflated once. What is kept is
copied: a view would keep its whole chunk alive. Stamps are those of the messages' headers.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone_recordings.bags.bag import Bag, Topic
from stone_recordings.bags.errors import MessageLayoutError
from stone_recordings.messages.pointcloud2 import layout_problem
from stone_recordings.messages.types.cdr import HEAD_BYTES, NS_PER_S, Cursor, check_encapsulation
from stone_recordings.topics.roles import POINT_CLOUD

STAMP_BYTES = HEAD_BYTES + 8
# A header with the longest frame_id anybody uses, and the size of a cloud behind it.
HEADER_BYTES = 256


@dataclass(frozen=True, slots=True)
class OwnMessage:
    """A payload that holds nothing else alive."""

    payload: memoryview


@dataclass(frozen=True, eq=False)
class RecordedTopics:
    """`heads`: the first bytes of every message of a scanned topic; `messages`: whole small messages of others.

    `problems`: of a topic of clouds, the numbers of those that cannot be decoded, and why.
    """

    topics: Mapping[str, Topic]
    heads: Mapping[str, list[bytes]] = field(default_factory=dict)
    messages: Mapping[str, list[OwnMessage]] = field(default_factory=dict)
    problems: Mapping[str, Mapping[int, str]] = field(default_factory=dict)

    def stamps_ns(self, topic: str) -> NDArray[np.int64]:
        """Header stamps (N,) of a scanned topic in log-time order. Raises MessageLayoutError, ByteOrderError."""
        heads, type_name = self.heads[topic], self.topics[topic].type
        for head in heads:
            check_encapsulation(memoryview(head), type_name)
            if len(head) < STAMP_BYTES:
                raise MessageLayoutError(type_name, f"{len(head)} bytes hold no header")
        raw = np.frombuffer(b"".join(head[HEAD_BYTES:STAMP_BYTES] for head in heads), "<u4").reshape(-1, 2)
        seconds = raw[:, 0].astype(np.int32).astype(np.int64)
        return np.asarray(seconds * NS_PER_S + raw[:, 1], dtype=np.int64)

    def frame_id(self, topic: str) -> str:
        """`frame_id` of the topic's first message; "" without messages. Raises as `stamps_ns`."""
        if not self.heads[topic]:
            return ""
        cursor = Cursor(memoryview(self.heads[topic][0]), self.topics[topic].type)
        cursor.stamp_ns()
        return cursor.text()

    def cloud_sizes(self, topic: str) -> NDArray[np.int64]:
        """Declared points (N,) of each cloud of a scanned PointCloud2 topic. Raises as `stamps_ns`."""
        return np.array([_cloud_size(head, self.topics[topic].type) for head in self.heads[topic]], np.int64)


@dataclass(frozen=True, eq=False)
class OrderedStamps:
    """`index` (M,) into what was recorded gives strictly increasing `stamps_ns` (M,)."""

    index: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    findings: tuple[Finding, ...]


def read_recorded(bag: Bag, scanned: tuple[str, ...], whole: tuple[str, ...]) -> RecordedTopics:
    """One pass over the topics named. Raises what `Bag.heads` raises."""
    topics = {topic.name: topic for topic in bag.topics}
    kept_bytes = {name: HEADER_BYTES if topics[name].type == POINT_CLOUD else STAMP_BYTES for name in scanned}
    heads = {name: [b""] * topics[name].count for name in scanned}
    payloads = {name: [b""] * topics[name].count for name in whole}
    problems: dict[str, dict[int, str]] = {name: {} for name in scanned if topics[name].type == POINT_CLOUD}
    for name, index, payload in bag.heads((*scanned, *whole), whole=whole):
        if name in payloads:
            payloads[name][index] = bytes(payload)
            continue
        heads[name][index] = bytes(payload[: kept_bytes[name] if index else HEADER_BYTES])
        if name in problems and (problem := layout_problem(payload)):
            problems[name][index] = problem
    messages = {name: [OwnMessage(memoryview(payload)) for payload in own] for name, own in payloads.items()}
    return RecordedTopics(topics, heads, messages, problems)


def in_order(topic: str, stamps_ns: NDArray[np.int64]) -> OrderedStamps:
    """Stamps sorted (stably) with repeats dropped, the first kept; both are said in findings, with the worst step."""
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
    return OrderedStamps(order[is_new], stamps_ns[order[is_new]], tuple(findings))


def _cloud_size(head: bytes, type_name: str) -> int:
    cursor = Cursor(memoryview(head), type_name)
    cursor.stamp_ns()
    cursor.text()
    return cursor.u32() * cursor.u32()
