"""A walk through a ROS 1 bag, record after record, up to its last whole one: what an index is made anew from.

**Conventions.** Where no record stands the walk goes on at the next place where a chunk is known to begin; where none
is known it ends. A chunk is taken whole or not at all. One that was begun and not ended counts as far as it inflates;
plain, its records are walked as those of the file itself.
"""

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

from stone_recordings.bags.chunks import UNDOUBTED_BYTES, inflate, pieces_of
from stone_recordings.bags.errors import IngestError, MalformedBagError
from stone_recordings.bags.ros1 import records as wire
from stone_recordings.bags.ros1.draft import OF_FILE, Ros1Draft, chunk_of
from stone_recordings.bags.ros1.records import Ros1Record


class Ros1Walk:
    """`draft` is what was found, `read_bytes` where the last whole record ends."""

    def __init__(self, view: memoryview, name: str, starts: Sequence[int], *, is_tolerant: bool) -> None:
        self.draft, self.read_bytes = Ros1Draft(starts=sorted(starts)), 0
        self._view, self._name, self._is_tolerant = view, name, is_tolerant

    def follow(self, at: int) -> None:
        """From the record at `at` on. Raises: MalformedBagError and what `inflate` raises, unless it is tolerant."""
        following: int | None = at
        while following is not None:
            self.read_bytes = following
            following = self._step(following) if following < len(self._view) else None
        for number in self.draft.undefined():
            self._lose(MalformedBagError(self._name, f"connection {number} is used and not defined"))
            del self.draft.entries[number]

    def _step(self, at: int) -> int | None:
        """Take the record at `at`; gives where the next one begins, None where none does."""
        record = self._head_at(at)
        if record is None:
            return self._resumed(at)
        if record.op == wire.CHUNK and self._is_begun(record):
            return self._resumed(at) if self._known_after(at) is not None else self._begun(record)
        if record.stop > len(self._view):
            return self._resumed(at)
        try:
            self._take(record)
        except IngestError as error:
            self._lose(error)
        return record.stop

    def _head_at(self, at: int) -> Ros1Record | None:
        try:
            record = wire.head_at(self._view, at, self._name)
        except MalformedBagError:
            return None
        return record if wire.MESSAGE <= record.op <= wire.CONNECTION else None

    def _is_begun(self, record: Ros1Record) -> bool:
        """Whether a chunk was not ended: the file ends in it, or its recorder has not written its length yet."""
        is_unsaid = record.start == record.stop and self._head_at(record.stop) is None
        return is_unsaid or record.stop > len(self._view)

    def _take(self, record: Ros1Record) -> None:
        if record.op != wire.CHUNK:
            self.draft.take(self._view, record, OF_FILE)
            return
        chunk = chunk_of(record, self._name)
        records, found = inflate(self._view, chunk), Ros1Draft()
        for inner in _records(records, chunk.where):
            found.take(records, inner, len(self.draft.chunks))
        self.draft.add_chunk(chunk, found)

    def _begun(self, record: Ros1Record) -> int | None:
        """Whatever is whole of a chunk that was not ended."""
        chunk, found, size_bytes = chunk_of(record, self._name), Ros1Draft(), 0
        if not chunk.compression:
            return record.start
        records = _inflated_part(self._view[record.start :], chunk.compression)
        with suppress(MalformedBagError):  # the last record was not written to its end
            for inner in _records(records, chunk.where):
                found.take(records, inner, len(self.draft.chunks))
                size_bytes = inner.stop
        if size_bytes:
            part = replace(chunk, uncompressed_bytes=size_bytes, stop=len(self._view), is_cut=True)
            self.draft.add_chunk(part, found)
        return None

    def _resumed(self, at: int) -> int | None:
        """Where the walk goes on where no record stands at `at`."""
        following = self._known_after(at)
        if following is not None:
            self._lose(MalformedBagError(self._name, f"the bytes {at} to {following} are not complete records"))
        return following

    def _known_after(self, at: int) -> int | None:
        starts = self.draft.starts
        return next(iter(starts[bisect_right(starts, at) :]), None)

    def _lose(self, error: IngestError) -> None:
        if not self._is_tolerant:
            raise error
        self.draft.losses.append(f"{str(error).partition('; ')[0]} ({error.code})")


def _records(view: memoryview, where: str) -> Iterator[Ros1Record]:
    """Messages and connections of a chunk. Raises: MalformedBagError where another record stands, or none."""
    at = 0
    while at < len(view):
        record = wire.record_at(view, at, where)
        if record.op not in (wire.MESSAGE, wire.CONNECTION):
            raise MalformedBagError(where, f"the record at byte {at} is of op {record.op}, not a message")
        yield record
        at = record.stop


def _inflated_part(packed: memoryview, compression: str) -> memoryview:
    found = bytearray()
    for piece in pieces_of(packed, compression):
        found += piece
        if len(found) > UNDOUBTED_BYTES:  # larger than any chunk that a recorder was still writing
            break
    return memoryview(found)
