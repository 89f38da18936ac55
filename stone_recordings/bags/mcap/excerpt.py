"""An excerpt of a remote MCAP file: the ranges to fetch, and a file of the fetched messages.

    its ends → its summary → heads and message indexes of its chunks → messages, some chunks at a time

**Conventions.** The local file has the whole size, with holes: `here` are the fetched ranges. A plan is computed until
it lacks nothing; pictures are left out unless they are wanted. Ranges are half-open.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.chunked_store import MappedFile
from stone_recordings.bags.content_hash import PICTURES
from stone_recordings.bags.errors import IngestError
from stone_recordings.bags.mcap import extras
from stone_recordings.bags.mcap.catalogue import chunk_indexes_of, summary_range
from stone_recordings.bags.mcap.copy import opened_copy
from stone_recordings.bags.mcap.store import McapStore

Range = tuple[int, int]
HEAD_BYTES, TAIL_BYTES = 512, 2**20
CHUNK_HEAD_BYTES = 128  # a chunk's head: 49 bytes, and the name of its compression
JOINED_BYTES = 64 * 2**10  # a gap between two ranges up to this size is read too
WHOLE_RATIO = 0.5  # beyond this share a chunk is read whole: then its checksum can be checked


@dataclass(frozen=True)
class ExcerptPlan:
    """`lacks` are the ranges required to locate messages; otherwise `chunks` has the ranges of messages by chunk."""

    lacks: tuple[Range, ...] = ()
    chunks: tuple[tuple[int, tuple[Range, ...]], ...] = ()


def first_ranges(size_bytes: int) -> list[Range]:
    """Return the ends of a file."""
    return joined_ranges([(0, min(HEAD_BYTES, size_bytes)), (max(0, size_bytes - TAIL_BYTES), size_bytes)])


def joined_ranges(ranges: Iterable[Range]) -> list[Range]:
    """Return the ranges in order, neighbouring ones merged."""
    joined: list[Range] = []
    for start, stop in sorted(ranges):
        if joined and start - joined[-1][1] <= JOINED_BYTES:
            joined[-1] = (joined[-1][0], max(stop, joined[-1][1]))
        else:
            joined.append((start, stop))
    return joined


def planned_excerpt(path: Path, here: Sequence[Range], *, with_pictures: bool) -> ExcerptPlan:
    """Return the ranges to read next. Raises `BAG-042` for a file without an index, and the errors of opening."""
    file = MappedFile(path)
    file.read_ahead(False)
    summary = summary_range(file.view, path.name)
    if summary is None:
        raise _no_index(path.name)
    if lacks := _missing([summary], here):
        return ExcerptPlan(lacks)
    indexes = chunk_indexes_of(file.view, path.name)
    if not indexes:
        raise _no_index(path.name)
    heads = [(index.chunk_offset, min(index.chunk_offset + CHUNK_HEAD_BYTES, index.stop)) for index in indexes]
    tails = [(index.stop - index.message_index_bytes, index.stop) for index in indexes]
    if lacks := _missing(joined_ranges([*heads, *tails]), here):
        return ExcerptPlan(lacks)
    store = McapStore(path)
    if not store.is_indexed:
        raise _no_index(path.name)
    return ExcerptPlan((), tuple(_chunks_of(store, with_pictures)))


def write_excerpt(path: Path, chunks: Range, target: Path, *, with_pictures: bool) -> int:
    """Write the wanted messages of a run of fetched chunks to `target`; return their number."""
    store = McapStore(path)
    store.read_sparingly()
    with target.open("wb") as stream, opened_copy(stream, "zstd") as copy:
        channels = {topic.name: copy.declare(topic) for topic in store.topics if _is_wanted(topic.type, with_pictures)}
        for name, channel in channels.items():
            number, times_ns = store.chunk_of_messages(name), store.log_times_ns(name)
            for row in np.flatnonzero((number >= chunks[0]) & (number < chunks[1])).tolist():
                at_ns = int(times_ns[row])
                copy.write(channel, name, extras.Message(channel, 0, at_ns, at_ns, store.payload(name, row)))
    return copy.messages


def _is_wanted(type_name: str, with_pictures: bool) -> bool:
    return with_pictures or type_name not in PICTURES


def _missing(wanted: Iterable[Range], here: Sequence[Range]) -> tuple[Range, ...]:
    return tuple(
        range_ for range_ in wanted if not any(start <= range_[0] and range_[1] <= stop for start, stop in here)
    )


def _chunks_of(store: McapStore, with_pictures: bool) -> Iterator[tuple[int, tuple[Range, ...]]]:
    """Yield the chunks with wanted messages, and their ranges in the file."""
    number, offset, is_wanted = _messages_in_order(store, with_pictures)
    starts = np.flatnonzero(np.append(True, number[1:] != number[:-1])) if len(number) else np.zeros(0, np.int64)
    for start, stop in pairwise([*starts.tolist(), len(number)]):
        wanted = is_wanted[start:stop]
        if not wanted.any():
            continue
        chunk = store.chunk(int(number[start]))
        ends = np.append(offset[start + 1 : stop], chunk.stop - chunk.start)
        ranges = [(chunk.start + int(offset[start + at]), chunk.start + int(ends[at])) for at in np.flatnonzero(wanted)]
        wanted_bytes = sum(end - begin for begin, end in ranges)
        if chunk.compression or wanted_bytes > WHOLE_RATIO * (chunk.stop - chunk.start):
            ranges = [(chunk.start, chunk.stop)]
        yield int(number[start]), tuple(joined_ranges(ranges))


def _messages_in_order(
    store: McapStore, with_pictures: bool
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Return chunk, offset in it and whether it is wanted, for all messages in file order."""
    none = np.zeros(0, np.int64)
    numbers = [store.chunk_of_messages(topic.name) for topic in store.topics]
    offsets = [store.offset_of_messages(topic.name) for topic in store.topics]
    wanted = [
        np.full(len(rows), _is_wanted(topic.type, with_pictures))
        for rows, topic in zip(numbers, store.topics, strict=True)
    ]
    number, offset = np.concatenate([none, *numbers]), np.concatenate([none, *offsets])
    order = np.lexsort((offset, number))
    return number[order], offset[order], np.concatenate([none.astype(np.bool_), *wanted])[order]


def _no_index(name: str) -> IngestError:
    return IngestError(
        "BAG-042",
        f"{name} has no index of its messages, so it cannot be read by ranges; rewrite it with "
        "`stone recover`, or upload it",
    )
