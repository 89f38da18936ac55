"""A recording that cannot be opened, or has no index, rewritten: chunked, indexed, with all whole messages.

**Conventions.** The original is only read. The copy is written beside its target and renamed when it is complete, so a
recovery that is killed leaves nothing under the target's name. Messages keep their log and publish time, sequence and
bytes, channels their metadata; ids may change. Memory is one chunk of either file.
"""

import mmap
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from stone.findings import Finding, Severity
from stone_files.atomic import atomic_file
from stone_recordings.bags.db3.store import SqliteStore
from stone_recordings.bags.errors import IngestError
from stone_recordings.bags.magic import container_of
from stone_recordings.bags.mcap.catalogue import sealed_bytes
from stone_recordings.bags.mcap.copy import Copy, opened_copy
from stone_recordings.bags.mcap.extras import Message
from stone_recordings.bags.mcap.salvage import Losses, SalvagedRecord, complete_records, first_compression, known_places
from stone_recordings.bags.members import members_of
from stone_recordings.bags.message_store import MessageStore
from stone_recordings.bags.private_folder import PrivateFolder, unpacked_file
from stone_recordings.bags.ros1.store import Ros1Store

# One file of a recording under recovery: its whole messages go into the copy. An MCAP file is walked record by record,
# and its index used only at damaged places. A database and a ROS 1 bag are read message by message, in log-time order,
# and ROS 1 messages become CDR. After `keep`, `losses` lists the rest.


FORGET_BYTES = 16 * 2**20
# Damaged pages; rows that are no messages; ROS 1 topics without a definition.
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
    """A mapped MCAP file; its first `sealed` bytes are the file, the rest are zeros."""

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
        definitions = {
            key: SalvagedRecord(self._view, record, self.name) for key, record in self._known.definitions.items()
        }
        copy.begin(self.losses, definitions)
        forgotten = 0
        for salvaged in complete_records(self._view, self.name, self.losses, self._known):
            copy.keep(salvaged)
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
        """Yield topic number, index and log time of every message."""
        times = [self._store.log_times_ns(name) for name in names]
        if not times:
            return
        number = np.concatenate([np.full(len(own), n) for n, own in enumerate(times)])
        index = np.concatenate([np.arange(len(own)) for own in times])
        time_ns = np.concatenate(times)
        for row in np.argsort(time_ns, kind="stable").tolist():
            yield int(number[row]), int(index[row]), int(time_ns[row])


def database_source(path: Path) -> StoreSource:
    """Return the source of a database, whose copy is uncompressed like itself. Raises: as `SqliteStore`."""
    return StoreSource(path.name, SqliteStore(path), "", path.stat().st_size)


def ros1_source(path: Path) -> StoreSource:
    """Return the source of a ROS 1 bag. Raises: as `Ros1Store`."""
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
    """Yield the source. Raises as `container_of`, `SqliteStore`, `Ros1Store` and `unpacked_file`."""
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


@dataclass(frozen=True)
class Recovery:
    """The kept and the lost messages.

    `topics` counts by name; `read_bytes` of the original's `total_bytes` hold complete records; `last_ns` is the latest
    log time kept, 0 without messages; `lost` is a sentence about the missing part.
    """

    messages: int
    topics: dict[str, int]
    read_bytes: int
    total_bytes: int
    last_ns: int
    lost: str
    finding: Finding

    def as_record(self) -> dict[str, object]:
        return {**asdict(self), "finding": self.finding.as_record()}


def recover(path: Path, out: Path) -> Recovery:
    """Write `out`, an MCAP file, from the whole messages of `path`: a file, or all the files of a folder.

    Recovering a file again gives the same bytes. Raises: FileNotFoundError, NotABagError (BAG-001), CutBagError (even
    the magic is cut), `BAG-026` (`out` is part of the original), `BAG-018`, `BAG-019`, OSError.
    """
    members = members_of(path)
    if out.exists() and any(out.samefile(file) for file in members.files):
        raise IngestError(
            "BAG-026", f"{out.name} is the original; recover into another file, the original is never written"
        )
    with ExitStack() as opened:
        sources = [opened.enter_context(opened_source(file)) for file in members.files]
        staging = opened.enter_context(atomic_file(out))
        with staging.open("wb") as stream, opened_copy(stream, sources[0].compression) as copy:
            for source in sources:
                source.keep(copy)
    return _in_words(path.name, sources, members.findings, copy)


def _in_words(name: str, sources: list[RecoverySource], noticed: tuple[Finding, ...], copy: Copy) -> Recovery:
    read_bytes, total_bytes = (sum(n) for n in zip(*((s.read_bytes, s.total_bytes) for s in sources), strict=True))
    is_sealed = all(source.losses.is_sealed for source in sources)
    is_broken = any(source.losses.problems for source in sources)
    is_whole = is_sealed and not noticed and not is_broken
    lost = _lost(sources, noticed, copy)
    counts = [source.losses.told_messages for source in sources]
    of_all = "" if None in counts else f" of {sum(count or 0 for count in counts)}"
    counted = f"{copy.messages}{of_all} messages of {len(copy.topics)} topics"
    kept = f"{counted}, the last logged at {copy.last_ns} ns, are recovered"
    whole = "is damaged" if is_broken else "is complete up to its index"
    ended = whole if is_sealed else f"was cut off at byte {read_bytes} of {total_bytes}"
    severity: Severity = "info" if is_whole else "warning"
    finding = Finding("BAG-010", severity, "", f"{name} {ended}: {kept}. {lost}")
    return Recovery(copy.messages, copy.topics, read_bytes, total_bytes, copy.last_ns, lost, finding)


def _lost(sources: list[RecoverySource], noticed: tuple[Finding, ...], copy: Copy) -> str:
    """Return one sentence; the duration of a cut part is an estimate from the mean rate of the kept messages."""
    kept_bytes = sum(source.read_bytes for source in sources)
    rate_s = (copy.last_ns - copy.first_ns) / 1e9 / max(1, kept_bytes)
    parts = [finding.message.removesuffix(".") for finding in noticed if finding.severity == "error"]
    for source in sources:
        about = f"{source.name}: " if len(sources) > 1 else ""
        parts += [f"{about}{part}" for part in _lost_of(source, rate_s)]
    return f"Lost: {'; '.join(parts)}." if parts else "Only the index is lost."


def _lost_of(source: RecoverySource, rate_s: float) -> Iterator[str]:
    left_bytes = source.total_bytes - source.read_bytes
    if left_bytes:
        yield f"the incomplete part of the last {left_bytes} bytes (about {left_bytes * rate_s:.3f} s)"
    if not source.losses.is_sealed:
        yield "data that the recorder had not written yet"
    yield from source.losses.problems
    if source.losses.unsaid:
        yield f"{source.losses.unsaid} more pieces"
