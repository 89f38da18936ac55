"""An MCAP like the ROS 2 recorder's: ros2msg schemas embedded, messages in log-time order.

**Conventions.** Messages are added in any order within a short window and leave through a heap: `flush_before` writes
everything logged earlier than an instant that no later message can precede. Memory holds only that window.
"""

import heapq
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mcap.writer import CompressionType, Writer

from simulator.options import Compression
from stone_recordings.messages.types.registry import message_definition

COMPRESSIONS = {"none": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}
CHUNK_BYTES = 4 << 20


class BagWriter:
    """A writer from `open_bag_writer`; call `add`, then `flush_before`."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._pending: list[tuple[int, int, str, bytes]] = []
        self._count = 0

    def declare(self, topic: str, kind: str) -> None:
        """Declare a topic and its type ("sensor_msgs/msg/Imu") before its first message."""
        if kind not in self._schemas:
            text = message_definition(kind).encode()
            self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", text)
        self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[kind])

    def add(self, topic: str, log_time_ns: int, payload: bytes) -> None:
        self._count += 1
        heapq.heappush(self._pending, (log_time_ns, self._count, topic, payload))

    def flush_before(self, stamp_ns: int) -> None:
        """Write the messages logged before `stamp_ns` in log order."""
        while self._pending and self._pending[0][0] < stamp_ns:
            log_time_ns, _, topic, payload = heapq.heappop(self._pending)
            self._writer.add_message(self._channels[topic], log_time_ns, payload, log_time_ns)


@contextmanager
def open_bag_writer(path: Path, compression: Compression) -> Iterator[BagWriter]:
    """Yield a writer of the bag at `path`; at the end the bag is complete, with summary and indexes."""
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=COMPRESSIONS[compression])
        writer.start("ros2", library="stone-simulator")
        bag = BagWriter(writer)
        yield bag
        bag.flush_before(2**62)
        writer.finish()  # type: ignore[no-untyped-call]
