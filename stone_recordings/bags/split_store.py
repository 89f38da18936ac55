"""Several files as one recording: a split bag of any container.

**Conventions.** Messages of a topic are in log-time order over all files; for equal times those of the earlier file
come first. Only the files used last stay open, so that memory and open files do not grow with their number.
"""

from collections import OrderedDict
from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone_recordings.bags.errors import MalformedBagError
from stone_recordings.bags.message_store import NO_MESSAGES, Messages, MessageStore, Topic

AWAKE = 2


class SplitStore:
    """`parts` in the order of the recording; they are closed with it."""

    def __init__(self, name: str, parts: Sequence[MessageStore]) -> None:
        self._parts = tuple(parts)
        self._awake: OrderedDict[int, None] = OrderedDict()
        self.is_indexed = all(part.is_indexed for part in self._parts)
        self.findings: tuple[Finding, ...] = tuple(finding for part in self._parts for finding in part.findings)
        listed = _by_name(self._parts)
        self.topics = tuple(_joined(name, listed[topic]) for topic in sorted(listed))
        self._places = {topic: self._placed(topic) for topic in listed}

    def log_times_ns(self, topic: str) -> NDArray[np.int64]:
        return self._places[topic][0]

    def payload(self, topic: str, index: int) -> memoryview:
        _times, parts, indices = self._places[topic]
        return self._woken(int(parts[index])).payload(topic, int(indices[index]))

    def heads(
        self, topics: Sequence[str], whole: Collection[str] = (), *, is_checked: bool = False
    ) -> Iterator[tuple[str, int, memoryview]]:
        """Yield file after file, each in its own order."""
        for number, part in enumerate(self._parts):
            own = {topic.name for topic in part.topics}
            here = [topic for topic in topics if topic in own]
            joined = {topic: self._rows_of(number, topic) for topic in here}
            for topic, index, payload in self._woken(number).heads(here, whole, is_checked=is_checked):
                yield topic, int(joined[topic][index]), payload

    def size_bytes(self, topic: str, index: int) -> int:
        _times, parts, indices = self._places[topic]
        return self._woken(int(parts[index])).size_bytes(topic, int(indices[index]))

    def damaged(self, beside: Messages = NO_MESSAGES) -> Mapping[str, Mapping[int, str]]:
        """Return the damaged messages of every file, under the indices of the whole."""
        damaged: dict[str, dict[int, str]] = {}
        for number in range(len(self._parts)):
            for topic, reasons in self._woken(number).damaged(self._among(number, beside)).items():
                rows = self._rows_of(number, topic)
                damaged.setdefault(topic, {}).update({int(rows[index]): reason for index, reason in reasons.items()})
        return damaged

    def read_sparingly(self) -> None:
        for part in self._parts:
            part.read_sparingly()

    def release(self) -> None:
        for part in self._parts:
            part.release()

    def close(self) -> None:
        for part in self._parts:
            part.close()

    def _rows_of(self, number: int, topic: str) -> NDArray[np.int64]:
        """Return the indices in the whole of the messages of one file, in its order."""
        _times, parts, indices = self._places[topic]
        rows = np.flatnonzero(parts == number)
        return rows[np.argsort(indices[rows])]

    def _among(self, number: int, messages: Messages) -> Messages:
        """Return the messages that lie in one file, under its own indices."""
        among = {}
        for topic, rows in messages.items():
            _times, parts, indices = self._places[topic]
            mine = rows[parts[rows] == number]
            if len(mine):
                among[topic] = indices[mine]
        return among

    def _woken(self, number: int) -> MessageStore:
        self._awake[number] = None
        self._awake.move_to_end(number)
        while len(self._awake) > AWAKE:
            self._parts[self._awake.popitem(last=False)[0]].release()
        return self._parts[number]

    def _placed(self, topic: str) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int64]]:
        """Return log times, part and index within it of every message."""
        own = [(number, part) for number, part in enumerate(self._parts) if topic in {t.name for t in part.topics}]
        times = [part.log_times_ns(topic) for _number, part in own]
        numbers = [np.full(len(part.log_times_ns(topic)), number, np.int32) for number, part in own]
        indices = [np.arange(len(part_times), dtype=np.int64) for part_times in times]
        joined_ns = np.concatenate(times)
        order = np.argsort(joined_ns, kind="stable")
        return joined_ns[order], np.concatenate(numbers)[order], np.concatenate(indices)[order]


def _by_name(parts: Sequence[MessageStore]) -> dict[str, list[Topic]]:
    listed: dict[str, list[Topic]] = {}
    for part in parts:
        for topic in part.topics:
            listed.setdefault(topic.name, []).append(topic)
    return listed


def _joined(name: str, topics: Sequence[Topic]) -> Topic:
    """Return one topic from those of the files; raises MalformedBagError if they contradict each other."""
    first = topics[0]
    for other in topics[1:]:
        if (other.type, other.encoding) != (first.type, first.encoding):
            problem = f"topic {first.name!r} is {first.type} in one file and {other.type} in another"
            raise MalformedBagError(name, problem)
    schema = next((topic.schema for topic in topics if topic.schema), "")
    return Topic(first.name, first.type, sum(topic.count for topic in topics), schema, first.encoding)
