"""Messages of a ROS 1 bag (version 2.0) as if recorded by ROS 2: types by their names in ROS 2, messages as CDR.

**Conventions.** As `stone_recordings.bags.chunked_store`; payloads are copies. A topic with unreadable types has the
encoding "ros1" and is left unread. Log times are the recorder's.
"""

from collections.abc import Iterator
from pathlib import Path

from stone.findings import Finding
from stone_recordings.bags.chunked_store import ChunkedStore, MappedFile, PlacedMessages, behind_end
from stone_recordings.bags.chunks import PIECE_BYTES
from stone_recordings.bags.errors import MalformedBagError
from stone_recordings.bags.message_places import Entries, GrowingEntries, in_log_order
from stone_recordings.bags.message_store import HEAD_BYTES
from stone_recordings.bags.ros1 import records as wire
from stone_recordings.bags.ros1.catalogue import BagState, Ros1Catalogue, read_ros1_catalogue
from stone_recordings.bags.ros1.definitions import Conversion, conversion_of, described
from stone_recordings.bags.ros1.records import Ros1Record

# The ROS 1 bytes that suffice for a head of CDR, which lacks `seq` and has padding.
ROS1_HEAD_BYTES = 2 * HEAD_BYTES
RECORD_HEAD_BYTES = 256


class Ros1Store(ChunkedStore):
    """One open bag; `is_indexed` is False if the whole file was walked.

    `compression` is that of the first chunk. With `is_tolerant` faults in the middle of the bag are skipped, and
    `state.losses` lists them. Raises: CutBagError (no message is whole), `BAG-036`, MalformedBagError and the refusals
    of chunks.
    """

    head_bytes = RECORD_HEAD_BYTES + ROS1_HEAD_BYTES

    def __init__(self, path: Path, *, is_tolerant: bool = False) -> None:
        file = MappedFile(path)
        catalogue = read_ros1_catalogue(file.view, path.name, is_tolerant=is_tolerant)
        self.state = catalogue.state
        super().__init__(file, PlacedMessages(catalogue.chunks, _by_topic(catalogue)))
        self._connections = catalogue.connections
        self.is_indexed = catalogue.state.is_indexed
        self.compression = next((chunk.compression for chunk in catalogue.chunks), "")
        counts = {topic: len(entries.offset) for topic, entries in self._entries.items()}
        self.topics, unread = described(tuple(catalogue.connections.values()), counts)
        self.findings: tuple[Finding, ...] = (*_ended(path, file, self.state, sum(counts.values())), *unread)
        self._sized = ("", 0, 0)

    def size_bytes(self, topic: str, index: int) -> int:
        """Return the size as CDR of the message whose head was just yielded; the rest is as long as in the bag."""
        if self._sized[:2] != (topic, index):
            self._head_found(self._seen_head(self._place(topic, index)[0]), topic, index, is_whole=False)
        return self._sized[2]

    def _found(self, view: memoryview, topic: str, index: int) -> memoryview:
        record = self._record(view, topic, index)
        return self._conversion(record).of_message(view[record.start : record.stop])

    def _head_found(self, view: memoryview, topic: str, index: int, is_whole: bool) -> memoryview:
        record = self._record(view, topic, index)
        conversion, size_bytes = self._conversion(record), record.stop - record.start
        if is_whole or size_bytes <= ROS1_HEAD_BYTES:
            payload = conversion.of_message(view[record.start : record.stop])
            self._sized = (topic, index, len(payload))
            return payload
        head = conversion.of_head(view[record.start : record.start + ROS1_HEAD_BYTES], HEAD_BYTES)
        self._sized = (topic, index, len(head.payload) + size_bytes - head.read_bytes)
        return head.payload

    def _record(self, view: memoryview, topic: str, index: int) -> Ros1Record:
        """Return the message's record. Raises: MalformedBagError if the record differs from the index."""
        number, offset = self._place(topic, index)
        record = wire.head_at(view, offset, self._where(number))
        is_promised = record.op == wire.MESSAGE and self._topic_of(record) == topic
        is_promised = is_promised and record.fields.time_ns("time") == self._entries[topic].log_time_ns[index]
        if not is_promised or record.stop > self._size_of(number):
            problem = f"the record at byte {offset} is not the message that the index lists"
            raise MalformedBagError(self._where(number), problem)
        return record

    def _topic_of(self, record: Ros1Record) -> str | None:
        connection = self._connections.get(record.fields.u32("conn"))
        return connection.topic if connection else None

    def _conversion(self, record: Ros1Record) -> Conversion:
        return conversion_of(self._connections[record.fields.u32("conn")].type)


def _ended(path: Path, file: MappedFile, state: BagState, messages: int) -> Iterator[Finding]:
    left_bytes = len(file.view) - state.read_bytes
    if not state.is_closed:
        message = (
            f"{file.name} was not closed by its recorder, or its end is missing: {messages} messages up to byte "
            f"{state.read_bytes} of {len(file.view)} are read, the incomplete data after them is left out."
        )
        yield Finding("BAG-010", "warning", "", message)
    elif left_bytes:
        yield behind_end(left_bytes, is_zero=_is_zero(path, state.read_bytes))


def _is_zero(path: Path, start: int) -> bool:
    """Return whether only zeros follow; reads the file, because touched pages of a map count as memory."""
    with path.open("rb") as file:
        file.seek(start)
        return not any(piece.strip(b"\0") for piece in iter(lambda: file.read(PIECE_BYTES), b""))


def _by_topic(catalogue: Ros1Catalogue) -> dict[str, Entries]:
    """Return entries in log-time order (ties: file order); several connections may carry one topic."""
    none = GrowingEntries().finished()
    parts: dict[str, list[Entries]] = {}
    for number, connection in sorted(catalogue.connections.items()):
        parts.setdefault(connection.topic, []).append(catalogue.entries.get(number, none))
    return {topic: in_log_order(listed) for topic, listed in parts.items()}
