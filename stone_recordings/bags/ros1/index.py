"""The index that a ROS 1 recorder writes when it closes its bag: connections, chunks, and behind each its messages.

**Conventions.** Raises MalformedBagError wherever it contradicts itself or the heads of the chunks.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.errors import MalformedBagError
from stone_recordings.bags.ros1 import records as wire
from stone_recordings.bags.ros1.draft import OF_FILE, Ros1Draft, chunk_of
from stone_recordings.bags.ros1.records import Ros1Record

ENTRY = np.dtype([("sec", "<u4"), ("nsec", "<u4"), ("offset", "<u4")])
VERSION = 1


@dataclass(frozen=True)
class _ChunkInfo:
    """Where a chunk is, and by connection how many messages it holds."""

    at: int
    counts: dict[int, int]


def read_index(view: memoryview, header: Ros1Record, draft: Ros1Draft, name: str) -> int:
    """Fills the draft; gives the byte where the index ends."""
    infos, at = [], header.fields.u64("index_pos")
    for _ in range(header.fields.u32("conn_count")):
        record = _expected(view, at, wire.CONNECTION, name)
        draft.take(view, record, OF_FILE)
        at = record.stop
    for _ in range(header.fields.u32("chunk_count")):
        record = _expected(view, at, wire.CHUNK_INFO, name)
        infos.append(_chunk_info(view, record))
        draft.starts.append(infos[-1].at)
        at = record.stop
    reached = header.stop
    for info in sorted(infos, key=lambda info: info.at):
        if info.at < reached:
            raise MalformedBagError(name, f"the chunk at byte {info.at} overlaps the one before it")
        reached = _add_chunk(view, info, draft, name)
    if undefined := draft.undefined():
        raise MalformedBagError(name, f"its index refers to connection {undefined[0]}, which is not defined")
    return at


def _add_chunk(view: memoryview, info: _ChunkInfo, draft: Ros1Draft, name: str) -> int:
    """Take the message indexes behind one chunk; gives the byte where they end."""
    record = _expected(view, info.at, wire.CHUNK, name)
    draft.chunks.append(chunk_of(record, name))
    counts: dict[int, int] = {}
    for _ in info.counts:
        record = _expected(view, record.stop, wire.INDEX, name)
        number, (times_ns, offsets) = record.fields.u32("conn"), _rows(view, record)
        counts[number] = counts.get(number, 0) + len(offsets)
        draft.entries_of(number).extend(times_ns, len(draft.chunks) - 1, offsets)
    if counts != info.counts:
        raise MalformedBagError(
            name, f"the index of the chunk at byte {info.at} does not have as many messages as the chunk info declares"
        )
    return record.stop


def _rows(view: memoryview, record: Ros1Record) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Times, and offsets in the chunk."""
    count, size_bytes = record.fields.u32("count"), record.stop - record.start
    if record.fields.u32("ver") != VERSION or size_bytes != count * ENTRY.itemsize:
        raise MalformedBagError(
            record.fields.where, f"the index at byte {record.at} has {size_bytes} bytes for {count}"
        )
    rows = np.frombuffer(view[record.start : record.stop], ENTRY)
    times_ns = rows["sec"].astype(np.int64) * wire.NS_PER_S + rows["nsec"]
    return times_ns, rows["offset"].astype(np.int64)


def _chunk_info(view: memoryview, record: Ros1Record) -> _ChunkInfo:
    count, data = record.fields.u32("count"), view[record.start : record.stop]
    if record.fields.u32("ver") != VERSION or len(data) != 8 * count:
        raise MalformedBagError(record.fields.where, f"the chunk info at byte {record.at} has {len(data)} bytes")
    table = np.frombuffer(data, "<u4").reshape(-1, 2).tolist()
    return _ChunkInfo(record.fields.u64("chunk_pos"), dict(table))


def _expected(view: memoryview, at: int, op: int, name: str) -> Ros1Record:
    record = wire.record_at(view, at, name)
    if record.op != op:
        raise MalformedBagError(name, f"the record at byte {at} is of op {record.op}, {op} is expected")
    return record
