"""Bags on one clock as one recording.

**Conventions.** As `stone_recordings.bags.split_store`, except that a topic with two types is reported with both
members.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from struct import Struct
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone_files.joined_file import GIVEN, REFERENCE, SAME_TOPICS, JoinedMember
from stone_recordings.bags.errors import ByteOrderError, IngestError, MessageLayoutError
from stone_recordings.bags.message_store import NO_MESSAGES, Messages, Topic
from stone_recordings.bags.split_store import SplitStore
from stone_recordings.clocks.timing import begins_with_header
from stone_recordings.messages.types.cdr import HEAD_BYTES, NS_PER_S, Cursor, check_encapsulation

# A bag on another clock: its log times and the stamps of its messages moved, duplicate messages left out. Indices count
# the remaining messages, in log-time order, which an offset does not change. Topics whose stamps are by the reference's
# clock keep them; their log times are moved all the same.


class OpenedBag(Protocol):
    """The part of a `stone_recordings.bags.bag.Bag` that is required to move it."""

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

    def read_sparingly(self) -> None: ...

    def release(self) -> None: ...

    def close(self) -> None: ...


class MovedBag:
    """`bag` moved as `member` describes; it is closed with it. A `MessageStore`."""

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
            if (position := int(left[topic][index])) >= 0:
                yield topic, position, self._moved(topic, payload)

    def size_bytes(self, topic: str, index: int) -> int:
        return self._bag.size_bytes(topic, int(self._kept[topic][index]))

    def damaged(self, beside: Messages = NO_MESSAGES) -> Mapping[str, Mapping[int, str]]:
        damaged = {}
        passed = {topic: self._kept[topic][rows] for topic, rows in beside.items()}
        for topic, reasons in self._bag.damaged_beside(passed).items():
            left = self._places_left(topic)
            damaged[topic] = {int(left[index]): why for index, why in reasons.items() if left[index] >= 0}
        return {topic: reasons for topic, reasons in damaged.items() if reasons}

    def read_sparingly(self) -> None:
        self._bag.read_sparingly()

    def release(self) -> None:
        self._bag.release()

    def close(self) -> None:
        self._bag.close()

    def _moved(self, topic: str, payload: memoryview) -> memoryview:
        return moved(payload, self._places[topic], self._offset_ns)

    def _places_left(self, topic: str) -> NDArray[np.int64]:
        """Return by index in the bag the index among the remaining messages; −1 for the others."""
        kept = self._kept[topic]
        places = np.full(len(self._bag.log_times_ns(topic)), -1, np.int64)
        places[kept] = np.arange(len(kept))
        return places

    def _rows(self, topic: Topic, member: JoinedMember) -> NDArray[np.int64]:
        """Return the indices of the remaining messages."""
        is_left = np.ones(topic.count, np.bool_)
        for start, stop in member.left_out.get(topic.name, ()):
            is_left[start:stop] = False
        return np.flatnonzero(is_left)


def _named(finding: Finding, member: str) -> Finding:
    """Return a member's finding about its whole recording as one about this file of the run."""
    return finding if finding.topic else replace(finding, topic=member)


def check_types(topics: Iterable[tuple[str, str]]) -> None:
    """Check `topics` of all recordings, by name and type. Raises: `BAG-041`."""
    types: dict[str, list[str]] = {}
    for name, type_name in topics:
        types.setdefault(name, []).append(type_name)
    for name, types_of_topic in types.items():
        if len(set(types_of_topic)) > 1:
            raise IngestError(
                "BAG-041",
                f"topic {name!r} is {' in one recording and '.join(dict.fromkeys(types_of_topic))} in another. "
                "Recordings of one run name their topics alike: leave one out, or rename the topic when it is recorded",
            )


def joined_store(name: str, parts: Sequence[MovedBag]) -> SplitStore:
    """Return the members as one store. Raises: `BAG-041`."""
    check_types((topic.name, topic.type) for part in parts for topic in part.topics)
    return SplitStore(name, parts)


# Header stamps moved within CDR messages, for types with a header and for lists of transforms. Times that a sensor took
# itself (GPS week and milliseconds, a radar's PTP time, packets, the times of points) are no recorder's or host's and
# stay. So do a stamp of zero, which means none, and a stamp that would leave its range: invalid stamps stay for the
# checks to report.


TRANSFORMS = "tf2_msgs/msg/TFMessage"
LAST_NS = 2**31 * NS_PER_S
POSE_BYTES = 56
StampPlaces = Literal["header", "transforms", "none"]

_STAMP = Struct("<iI")


def stamp_places(topic: Topic, has_header: bool) -> StampPlaces:
    """Return the places of stamps in the topic's messages."""
    if topic.type == TRANSFORMS:
        return "transforms"
    return "header" if has_header else "none"


def moved(payload: memoryview, places: StampPlaces, offset_ns: int) -> memoryview:
    """Return the message with `offset_ns` added to its stamps; itself without stamps, or without readable CDR.

    If a message is cut short, the stamps in the remaining part are moved.
    """
    offsets = list(_places(payload, places)) if offset_ns else []
    if not offsets:
        return payload
    content = bytearray(payload)
    for offset in offsets:
        _move(content, offset, offset_ns)
    return memoryview(content).toreadonly()


def _places(payload: memoryview, places: StampPlaces) -> Iterator[int]:
    try:
        if places == "header":
            check_encapsulation(payload, "")
            if len(payload) >= HEAD_BYTES + _STAMP.size:
                yield HEAD_BYTES
        elif places == "transforms":
            yield from _of_transforms(Cursor(payload, TRANSFORMS))
    except (MessageLayoutError, ByteOrderError):
        return


def _of_transforms(cursor: Cursor) -> Iterator[int]:
    """Yield the places. Raises: MessageLayoutError if the message ends before its last transform."""
    for _ in range(cursor.u32()):
        yield cursor.take(8, 4)
        for _name in range(2):
            cursor.take(cursor.u32())
        cursor.take(POSE_BYTES, 8)


def _move(content: bytearray, offset: int, offset_ns: int) -> None:
    sec, nanosec = _STAMP.unpack_from(content, offset)
    stamp_ns = sec * NS_PER_S + nanosec
    if stamp_ns and 0 < stamp_ns + offset_ns < LAST_NS:
        _STAMP.pack_into(content, offset, *divmod(stamp_ns + offset_ns, NS_PER_S))


# The coverage of the members of a joined recording, by their log times on one clock. SYN-527 a member that does not
# cover the reference, SYN-528 a gap between a member's end and the next one's continuation of its topics.


LEAST_MISSING_NS = 1_000_000_000
GAP_PERIODS = 2.5


@dataclass(frozen=True, eq=False)
class _Span:
    name: str
    is_reference: bool
    times_ns: dict[str, NDArray[np.int64]]

    @property
    def start_ns(self) -> int:
        return min(int(times[0]) for times in self.times_ns.values())

    @property
    def end_ns(self) -> int:
        return max(int(times[-1]) for times in self.times_ns.values())


def coverage_findings(members: Sequence[JoinedMember], bags: Sequence[MovedBag]) -> tuple[Finding, ...]:
    """Return the findings in order of the members, then of time."""
    spans = [_span(member, bag) for member, bag in zip(members, bags, strict=True)]
    spans = [span for span in spans if span.times_ns]
    return (*_missing(spans), *_gaps(spans))


def _span(member: JoinedMember, bag: MovedBag) -> _Span:
    is_reference = member.known_by in ((REFERENCE,), (SAME_TOPICS,))
    times = {topic.name: bag.log_times_ns(topic.name) for topic in bag.topics if topic.count}
    return _Span(member.name, is_reference, times)


def _missing(spans: Sequence[_Span]) -> Iterator[Finding]:
    reference = [span for span in spans if span.is_reference]
    if not reference:
        return
    start_ns, end_ns = min(span.start_ns for span in reference), max(span.end_ns for span in reference)
    for span in spans:
        late_ns, early_ns = span.start_ns - start_ns, end_ns - span.end_ns
        if not span.is_reference and max(late_ns, early_ns) > LEAST_MISSING_NS:
            missing = [
                f"the {which} {min(ns, end_ns - start_ns) / 1e9:.1f} s"
                for which, ns in (("first", late_ns), ("last", early_ns))
                if ns > LEAST_MISSING_NS
            ]
            sentence = f"it has no messages in {' and '.join(missing)} of the run: frames there lack its sensors"
            yield Finding("SYN-527", "warning", span.name, sentence)


def _gaps(spans: Sequence[_Span]) -> Iterator[Finding]:
    """Yield gaps in which topics of two members stop for longer than their usual pauses."""
    reported = set[tuple[str, str]]()
    for topic in sorted({name for span in spans for name in span.times_ns}):
        holding = sorted((span for span in spans if topic in span.times_ns), key=lambda span: span.times_ns[topic][0])
        for earlier, two in pairwise(holding):
            before, after = earlier.times_ns[topic], two.times_ns[topic]
            gap_ns, steps_ns = int(after[0] - before[-1]), np.diff(before)
            if (
                (earlier.name, two.name) in reported
                or len(steps_ns) < 2
                or gap_ns <= GAP_PERIODS * float(np.median(steps_ns))
            ):
                continue
            reported.add((earlier.name, two.name))
            sentence = (
                f"between its last message in {earlier.name} and its first in {two.name} lie {gap_ns / 1e9:.3f} s"
            )
            yield Finding("SYN-528", "warning", topic, sentence)


# Findings about a joined recording on every opening: moved clocks, and duplicate messages. SYN-520 a measured offset,
# SYN-521 a given one, SYN-522 messages in two members. SYN-527 and SYN-528 are of `coverage` beside it; SYN-523 …
# SYN-526 refuse (`stone_recordings.joining.joined_recording`).


def member_findings(members: Sequence[JoinedMember]) -> tuple[Finding, ...]:
    """Return the findings in the order of the members."""
    reference = next((member.name for member in members if REFERENCE in member.known_by), "the reference")
    return tuple(finding for member in members for finding in _of(member, reference))


def _of(member: JoinedMember, reference: str) -> Iterator[Finding]:
    if REFERENCE not in member.known_by:
        yield _offset_finding(member, reference)
    for topic, count in sorted(member.count_left_out().items()):
        sentence = f"{count} of its messages in {member.name} are also in another file of the run, and used once"
        yield Finding("SYN-522", "info", topic, sentence)


def _offset_finding(member: JoinedMember, reference: str) -> Finding:
    moved = f"its stamps are shifted by {member.offset_ns / 1e9:+.6f} s onto the clock of {reference}"
    if GIVEN in member.known_by:
        return Finding("SYN-521", "info", member.name, f"{moved}, as given by the user; it was not measured")
    if member.known_by == (SAME_TOPICS,):
        sentence = (
            f"it contains topics of {reference}, whose stamps continue: the recorder split the run; nothing is shifted"
        )
        return Finding("SYN-520", "info", member.name, sentence)
    if not member.offset_ns:
        sentence = f"it is on the clock of {reference}, by {' and '.join(member.known_by)}; nothing is shifted"
        return Finding("SYN-520", "info", member.name, sentence)
    error = "" if member.sigma_ns is None else f" ± {member.sigma_ns / 1e6:.2f} ms (standard error)"
    return Finding("SYN-520", "info", member.name, f"{moved}{error}, measured by {' and '.join(member.known_by)}")
