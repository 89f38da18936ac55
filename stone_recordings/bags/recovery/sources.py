"""One file of a recording that is recovered: what is whole of it goes into the copy.

**Conventions.** An MCAP file is walked record by record, and its index asked only where that is damaged; a database
and a ROS 1 bag are read message by message, in log-time order, and what a bag holds becomes CDR. `losses` says what was
not whole once `keep` is through.
"""

import mmap
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Protocol

import numpy as np

from stone_recordings.bags.db3.store import SqliteStore
from stone_recordings.bags.errors import IngestError
from stone_recordings.bags.magic import container_of
from stone_recordings.bags.mcap.copy import Copy
from stone_recordings.bags.mcap.extras import Message
from stone_recordings.bags.mcap.known_places import known_places
from stone_recordings.bags.mcap.salvage import Losses, SalvagedRecord, complete_records, first_compression
from stone_recordings.bags.mcap.sealed_end import sealed_bytes
from stone_recordings.bags.message_store import MessageStore
from stone_recordings.bags.packed_file import unpacked_file
from stone_recordings.bags.private_folder import PrivateFolder
from stone_recordings.bags.ros1.store import Ros1Store

FORGET_BYTES = 16 * 2**20
# Damaged pages; rows that are no messages; of ROS 1 topics that are not described.
LOSSES = ("BAG-030", "BAG-031", "BAG-020", "MSG-307")


class RecoverySource(Protocol):
    """`read_bytes` of `total_bytes` hold complete records, known after `keep`; `compression` is that of its chunks."""

    name: str
    compression: str
    losses: Losses
    total_bytes: int

    @property
    def read_bytes(self) -> int: ...

    def keep(self, copy: Copy) -> None: ...


class McapSource:
    """A mapped MCAP file; `sealed` bytes of it are the file, the rest are zeros."""

    def __init__(self, name: str, mapped: mmap.mmap, sealed: int) -> None:
        self.name, self.losses, self.total_bytes = name, Losses(), len(mapped)
        self._mapped = mapped
        self._view = memoryview(mapped)[:sealed]
        self._known = known_places(self._view, name)
        self.losses.told_messages = self._known.messages
        self.compression = first_compression(self._view, name, self._known)

    @property
    def read_bytes(self) -> int:
        return self.total_bytes if self.losses.is_sealed else self.losses.stop_byte

    def keep(self, copy: Copy) -> None:
        definitions = {key: SalvagedRecord(self._view, one, self.name) for key, one in self._known.definitions.items()}
        copy.begin(self.losses, definitions)
        forgotten = 0
        for found in complete_records(self._view, self.name, self.losses, self._known):
            copy.keep(found)
            if self.losses.stop_byte - forgotten > FORGET_BYTES:
                forgotten = self.losses.stop_byte // mmap.PAGESIZE * mmap.PAGESIZE
                self._mapped.madvise(mmap.MADV_DONTNEED, 0, forgotten)
        copy.say_unknown()


class StoreSource:
    """A store whose messages are taken in log-time order: a database, or a ROS 1 bag, sound or damaged."""

    def __init__(self, name: str, store: MessageStore, compression: str, total_bytes: int) -> None:
        self.name, self.compression, self.total_bytes = name, compression, total_bytes
        self.losses = Losses(stop_byte=total_bytes, is_sealed=True)
        self._store = store

    @property
    def read_bytes(self) -> int:
        return self.losses.stop_byte

    def keep(self, copy: Copy) -> None:
        copy.begin(self.losses)
        copy.start("ros2")
        for finding in self._store.findings:
            if finding.code in LOSSES:
                self.losses.add(finding.message.removesuffix("."))
        topics = [topic for topic in self._store.topics if topic.count and topic.encoding == "cdr"]
        channels = [copy.declare(topic) for topic in topics]
        for number, index, time_ns in self._in_log_order([topic.name for topic in topics]):
            name = topics[number].name
            try:
                data = self._store.payload(name, index)
            except IngestError as error:
                self.losses.refuse(error)
                continue
            copy.write(channels[number], name, Message(0, 0, time_ns, time_ns, data))

    def close(self) -> None:
        self._store.close()

    def _in_log_order(self, names: list[str]) -> Iterator[tuple[int, int, int]]:
        """Topic number, index and log time of every message."""
        times = [self._store.log_times_ns(name) for name in names]
        if not times:
            return
        number = np.concatenate([np.full(len(own), n) for n, own in enumerate(times)])
        index = np.concatenate([np.arange(len(own)) for own in times])
        time_ns = np.concatenate(times)
        for row in np.argsort(time_ns, kind="stable").tolist():
            yield int(number[row]), int(index[row]), int(time_ns[row])


def database_source(path: Path) -> StoreSource:
    """Its chunks are not packed, as it was not. Raises: as `SqliteStore`."""
    return StoreSource(path.name, SqliteStore(path), "", path.stat().st_size)


def ros1_source(path: Path) -> StoreSource:
    """Raises: as `Ros1Store`."""
    store = Ros1Store(path, is_tolerant=True)
    source = StoreSource(path.name, store, store.compression, path.stat().st_size)
    source.losses.is_sealed = store.state.is_closed
    if not store.state.is_closed:
        source.losses.stop_byte = store.state.read_bytes
    for loss in store.state.losses:
        source.losses.add(loss)
    return source


STORED: Mapping[str, Callable[[Path], StoreSource]] = {"sqlite": database_source, "ros1": ros1_source}


@contextmanager
def opened_source(file: Path) -> Iterator[RecoverySource]:
    """Raises as `container_of`, `SqliteStore`, `Ros1Store` and `unpacked_file`."""
    folder = PrivateFolder()
    try:
        path = unpacked_file(file, folder) if container_of(file) == "zstd" else file
        if (container := container_of(path)) in STORED:
            with closing(STORED[container](path)) as source:
                yield source
        else:
            with path.open("rb") as stream:
                mapped = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
                sealed = sealed_bytes(stream)
            yield McapSource(path.name, mapped, len(mapped) if sealed is None else sealed)
    finally:
        folder.close()
