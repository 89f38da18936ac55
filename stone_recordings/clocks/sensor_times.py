"""The time that a sensor writes into its messages beside the header stamp, which its driver may have made up.

**Conventions.** Every NovAtel log begins with header and `Oem7Header`: GPS week and milliseconds, the week 0 while the
receiver knows none. An ARS 548 list has seconds and nanoseconds, and the status 1 where they are PTP's. Both stand at
the beginning, so `OWN_TIME_BYTES` of a message suffice. Sources: novatel_oem7_msgs, in which humble and master agree up
to the milliseconds; ars548_messages, ARS 548 RDI interface.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.topic import Topic
from stone_recordings.messages.batch import StampedMessage
from stone_recordings.messages.gps_time import unix_ns
from stone_recordings.messages.types.cdr import Cursor

OWN_TIME_BYTES = 512
SYNC_OK = 1
_NOVATEL, _ARS548 = "novatel_oem7_msgs/msg/", "ars548_messages/msg/DetectionList"
_Parsed = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class OwnTimes:
    """Of the N messages that tell one: header stamps and the sensor's own times (UTC), both (N,); `total` messages."""

    header_ns: NDArray[np.int64]
    own_ns: NDArray[np.int64]
    total: int

    @property
    def late_ns(self) -> NDArray[np.int64]:
        """How much later the header stamps are than the sensor's own times."""
        return self.header_ns - self.own_ns


def has_own_time(topic: Topic) -> bool:
    """Whether messages of the topic's type carry a time of the sensor's."""
    lines = [line.split("#")[0].split() for line in topic.schema.splitlines()]
    fields = [words[0].rpartition("/")[2] for words in lines if words]
    return topic.type == _ARS548 or (topic.type.startswith(_NOVATEL) and fields[1:2] in ([], ["Oem7Header"]))


def own_times(topic: Topic, messages: Sequence[StampedMessage]) -> OwnTimes:
    """The first bytes of messages are enough. Raises: MessageLayoutError, ByteOrderError."""
    parse = _ars548 if topic.type == _ARS548 else _novatel
    rows = [parse(Cursor(message.payload, topic.type)) for message in messages]
    told = np.array([row for row in rows if row is not None], np.int64).reshape(-1, 3)
    own_ns = _own_ns(topic, told[:, 1], told[:, 2])
    return OwnTimes(told[:, 0], own_ns, len(messages))


def _own_ns(topic: Topic, whole: NDArray[np.int64], rest: NDArray[np.int64]) -> NDArray[np.int64]:
    return whole * 1_000_000_000 + rest if topic.type == _ARS548 else unix_ns(whole, rest)


def _novatel(cursor: Cursor) -> _Parsed | None:
    """Header stamp, GPS week, milliseconds of the week."""
    stamp_ns = cursor.stamp_ns()
    cursor.text()
    cursor.text()
    cursor.take(2, 2), cursor.u8(), cursor.u32(), cursor.u8()
    start = cursor.take(2, 2)
    week = int.from_bytes(cursor.payload[start : start + 2], "little")
    milliseconds = cursor.u32()
    return (stamp_ns, week, milliseconds) if week else None


def _ars548(cursor: Cursor) -> _Parsed | None:
    """Header stamp, the radar's seconds, its nanoseconds."""
    stamp_ns = cursor.stamp_ns()
    cursor.text()
    cursor.take(8, 8), cursor.take(12, 4)
    nanoseconds, seconds, status = cursor.u32(), cursor.u32(), cursor.u8()
    return (stamp_ns, seconds, nanoseconds) if status == SYNC_OK else None
