"""Header stamps moved within CDR messages: of a type that begins with a header, and of lists of transforms.

**Conventions.** Times that a sensor took itself (GPS week and milliseconds, a radar's PTP time, packets, the times of
points) are no recorder's or host's and stay. So does a stamp of zero, which is none, and one that would leave what a
stamp can hold: what is garbage stays garbage, for the checks of stamps to name.
"""

from collections.abc import Iterator
from struct import Struct
from typing import Literal

from stone_recordings.bags.errors import ByteOrderError, MessageLayoutError
from stone_recordings.bags.topic import Topic
from stone_recordings.messages.types.cdr import HEAD_BYTES, NS_PER_S, Cursor, check_encapsulation

TRANSFORMS = "tf2_msgs/msg/TFMessage"
LAST_NS = 2**31 * NS_PER_S
POSE_BYTES = 56
StampPlaces = Literal["header", "transforms", "none"]

_STAMP = Struct("<iI")


def stamp_places(topic: Topic, has_header: bool) -> StampPlaces:
    """Where the topic's messages have stamps."""
    if topic.type == TRANSFORMS:
        return "transforms"
    return "header" if has_header else "none"


def moved(payload: memoryview, places: StampPlaces, offset_ns: int) -> memoryview:
    """The message with `offset_ns` added to its stamps; itself where there is none to move, or no CDR to find it in.

    Of a message that is cut short the stamps in what is there are moved.
    """
    found = list(_places(payload, places)) if offset_ns else []
    if not found:
        return payload
    content = bytearray(payload)
    for place in found:
        _move(content, place, offset_ns)
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
    """Raises: MessageLayoutError where the message ends before its last transform."""
    for _ in range(cursor.u32()):
        yield cursor.take(8, 4)
        for _name in range(2):
            cursor.take(cursor.u32())
        cursor.take(POSE_BYTES, 8)


def _move(content: bytearray, place: int, offset_ns: int) -> None:
    sec, nanosec = _STAMP.unpack_from(content, place)
    stamp_ns = sec * NS_PER_S + nanosec
    if stamp_ns and 0 < stamp_ns + offset_ns < LAST_NS:
        _STAMP.pack_into(content, place, *divmod(stamp_ns + offset_ns, NS_PER_S))
