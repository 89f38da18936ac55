"""A bag on another clock: its log times and the stamps of its messages moved, messages that are had twice left out.

**Conventions.** Indices count the messages that are left, in log-time order, which an offset does not change. Topics
whose stamps are of the reference's clock keep them; their log times are moved all the same.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone_files.joined_file import JoinedMember
from stone_recordings.bags.joined.moved_stamps import StampPlaces, moved, stamp_places
from stone_recordings.bags.message_store import NO_MESSAGES, Messages
from stone_recordings.bags.topic import Topic
from stone_recordings.clocks.timing import begins_with_header


class OpenedBag(Protocol):
    """What of a `stone_recordings.bags.bag.Bag` is needed to move it."""

    topics: tuple[Topic, ...]
    findings: tuple[Finding, ...]

    @property
    def is_indexed(self) -> bool: ...

    def damaged_beside(self, messages: Messages) -> Mapping[str, Mapping[int, str]]: ...

    def log_times_ns(self, topic: str) -> NDArray[np.int64]: ...

    def payload(self, topic: str, index: int) -> memoryview: ...

    def heads(
        self, topics: Sequence[str], whole: Collection[str] = (), *, is_checked: bool = False
    ) -> Iterator[tuple[str, int, memoryview]]: ...

    def size_bytes(self, topic: str, index: int) -> int: ...

    def release(self) -> None: ...

    def close(self) -> None: ...


class MovedBag:
    """`bag` as `member` says; it is closed with it. A `MessageStore`."""

    def __init__(self, bag: OpenedBag, member: JoinedMember) -> None:
        self._bag, self._offset_ns = bag, member.offset_ns
        self.is_indexed = bag.is_indexed
        self.findings = tuple(_named(finding, member.name) for finding in bag.findings)
        self._kept = {topic.name: self._rows(topic, member) for topic in bag.topics}
        self.topics = tuple(replace(topic, count=len(self._kept[topic.name])) for topic in bag.topics)
        self._places: dict[str, StampPlaces] = {
            topic.name: "none" if topic.name in member.kept_topics else stamp_places(topic, begins_with_header(topic))
            for topic in bag.topics
        }

    def log_times_ns(self, topic: str) -> NDArray[np.int64]:
        return np.asarray(self._bag.log_times_ns(topic)[self._kept[topic]] + self._offset_ns, np.int64)

    def payload(self, topic: str, index: int) -> memoryview:
        return self._moved(topic, self._bag.payload(topic, int(self._kept[topic][index])))

    def heads(
        self, topics: Sequence[str], whole: Collection[str] = (), *, is_checked: bool = False
    ) -> Iterator[tuple[str, int, memoryview]]:
        left = {topic: self._places_left(topic) for topic in topics}
        for topic, index, payload in self._bag.heads(topics, whole, is_checked=is_checked):
            if (place := int(left[topic][index])) >= 0:
                yield topic, place, self._moved(topic, payload)

    def size_bytes(self, topic: str, index: int) -> int:
        return self._bag.size_bytes(topic, int(self._kept[topic][index]))

    def damaged(self, beside: Messages = NO_MESSAGES) -> Mapping[str, Mapping[int, str]]:
        found = {}
        passed = {topic: self._kept[topic][rows] for topic, rows in beside.items()}
        for topic, reasons in self._bag.damaged_beside(passed).items():
            left = self._places_left(topic)
            found[topic] = {int(left[index]): why for index, why in reasons.items() if left[index] >= 0}
        return {topic: reasons for topic, reasons in found.items() if reasons}

    def release(self) -> None:
        self._bag.release()

    def close(self) -> None:
        self._bag.close()

    def _moved(self, topic: str, payload: memoryview) -> memoryview:
        return moved(payload, self._places[topic], self._offset_ns)

    def _places_left(self, topic: str) -> NDArray[np.int64]:
        """By index in the bag, the index among what is left; −1 of what is not."""
        kept = self._kept[topic]
        places = np.full(len(self._bag.log_times_ns(topic)), -1, np.int64)
        places[kept] = np.arange(len(kept))
        return places

    def _rows(self, topic: Topic, member: JoinedMember) -> NDArray[np.int64]:
        """The indices of the messages that are left."""
        is_left = np.ones(topic.count, np.bool_)
        for start, stop in member.left_out.get(topic.name, ()):
            is_left[start:stop] = False
        return np.flatnonzero(is_left)


def _named(finding: Finding, member: str) -> Finding:
    """What was noticed about the whole of a member is about this file of the run."""
    return finding if finding.topic else replace(finding, topic=member)
