"""Messages of everything that is not one MCAP file, through rosbags: `.db3` databases, folders, split bags.

**Conventions.** The slow path: messages come one query at a time, forward reads are cheap, jumps cost a query. What
rosbags raises on damaged input is of many kinds, so it becomes one coded refusal here.
"""

from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader

from services.ingest.errors import SlowPathRefusedError
from services.ingest.topic import Topic

_T = TypeVar("_T")
_Stream = Generator[tuple[Connection, int, bytes], None, None]


class RosbagsStore:
    """One open rosbag2; `is_indexed` is True because a database always is."""

    is_indexed = True

    def __init__(self, path: Path) -> None:
        self._name = path.name
        self._reader = self._guarded(lambda: Reader(path))
        self._guarded(self._reader.open)
        self._connections: dict[str, list[Connection]] = {}
        for connection in self._reader.connections:
            self._connections.setdefault(connection.topic, []).append(connection)
        self._times = self._guarded(self._all_times)
        self.topics = tuple(self._topic(name) for name in sorted(self._connections))
        self._stream: _Stream | None = None
        self._next: tuple[str, int] = ("", 0)

    def log_times_ns(self, topic: str) -> NDArray[np.int64]:
        return self._times[topic]

    def payload(self, topic: str, index: int) -> memoryview:
        return memoryview(self._guarded(lambda: self._read(topic, index)))

    def heads(self, topics: Sequence[str]) -> Iterator[tuple[str, int, memoryview]]:
        """Topic by topic: a database has no chunks that would be opened twice."""
        for topic in topics:
            for index in range(len(self._times[topic])):
                yield topic, index, self.payload(topic, index)

    def close(self) -> None:
        self._stream = None
        if self._reader.is_open:
            self._reader.close()

    def _read(self, topic: str, index: int) -> bytes:
        """Continue where the last read of this topic ended, else start again at the message's time."""
        if self._stream is None or self._next != (topic, index):
            time_ns = int(self._times[topic][index])
            self._stream = self._reader.messages(self._connections[topic], start=time_ns)
            for _earlier in range(index - int(np.searchsorted(self._times[topic], time_ns))):
                next(self._stream)
        self._next = (topic, index + 1)
        return next(self._stream)[2]

    def _all_times(self) -> dict[str, NDArray[np.int64]]:
        lists: dict[str, list[int]] = {name: [] for name in self._connections}
        for connection, time_ns, _payload in self._reader.messages():
            lists[connection.topic].append(time_ns)
        return {name: np.sort(np.array(times, np.int64)) for name, times in lists.items()}

    def _topic(self, name: str) -> Topic:
        first = self._connections[name][0]
        return Topic(name, first.msgtype, len(self._times[name]), str(first.msgdef.data))

    def _guarded(self, read: Callable[[], _T]) -> _T:
        try:
            return read()
        except FileNotFoundError:
            raise
        except Exception as error:  # apsw, yaml, zstd, KeyError, AssertionError …: all mean damage here
            raise SlowPathRefusedError(self._name, f"{type(error).__name__}: {error}"[:200]) from error
