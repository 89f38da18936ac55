"""Faults of single messages, detected in their first bytes: one path for inspection and synchronisation.

**Conventions.** A head is a whole message, or at least the first `HEAD_BYTES` of one (`Bag.heads`). Codes are words for
programs: they become the codes of excluded frames.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone_recordings.bags.errors import ByteOrderError, MessageLayoutError, PoseValueError
from stone_recordings.messages.batch import StampedMessage
from stone_recordings.messages.camera import CAMERA_TYPES, picture_problem
from stone_recordings.messages.lidars.models import COMPRESSED_CLOUD, LIVOX_TYPES
from stone_recordings.messages.pointcloud2 import TYPE as POINT_CLOUD
from stone_recordings.messages.sweep_clouds import points_problem
from stone_recordings.messages.types.cdr import HEAD_BYTES, Cursor

STAMP_END = HEAD_BYTES + 8
PLAIN_CDR, SIGN = b"\0\1", 0x80
MALFORMED, UNSTAMPED, DAMAGED, OTHER_FRAME, STRAY = (
    "malformed_sweep",
    "no_stamp",
    "damaged_chunk",
    "other_sensor",
    "stray_stamp",
)
Read = TypeVar("Read")
# Types that are checked beyond the header.
_LOOKED_AT = frozenset({POINT_CLOUD, COMPRESSED_CLOUD, *LIVOX_TYPES, *CAMERA_TYPES})


@dataclass(frozen=True, slots=True)
class MessageProblem:
    """The reason why a message is left out: `code` for programs, `reason` for people."""

    code: str
    reason: str


def head_problem(head: memoryview, type_name: str, size_bytes: Callable[[], int]) -> MessageProblem | None:
    """Return the fault of a stamped message, or None; `size_bytes` returns the size beyond its head."""
    try:
        cursor = Cursor(head, type_name)
        stamp_ns = cursor.stamp_ns()
        cursor.text()
        picture = picture_problem(head, type_name, size_bytes)
    except (MessageLayoutError, ByteOrderError) as error:
        return MessageProblem(MALFORMED, str(error))
    if problem := points_problem(head, type_name, size_bytes):
        return MessageProblem(MALFORMED, problem)
    if picture:
        return MessageProblem(MALFORMED, picture)
    return MessageProblem(UNSTAMPED, "its stamp is 0") if stamp_ns == 0 else None


@dataclass
class TopicHeads:
    """Checks the messages of one topic by `head_problem`, one after another.

    Most messages have the same frame name after the stamp. If the last one was valid, and only the header of the type
    is checked, a message with the same first bytes is valid too.
    """

    type_name: str
    _name: bytes = b""

    def problem(self, head: memoryview, size_bytes: Callable[[], int]) -> MessageProblem | None:
        """Return the fault of a message as `head_problem` does."""
        if self._name and head[STAMP_END : STAMP_END + len(self._name)] == self._name and _is_dated(head):
            return None
        problem = head_problem(head, self.type_name, size_bytes)
        if problem is None and self.type_name not in _LOOKED_AT:
            cursor = Cursor(head, self.type_name)
            cursor.stamp_ns()
            cursor.text()
            self._name = bytes(head[STAMP_END : cursor.at])
        return problem


def _is_dated(head: memoryview) -> bool:
    """Return whether it is plain CDR with a stamp after 1970; other messages may have a stamp all the same."""
    return head[:2] == PLAIN_CDR and head[STAMP_END - 5] < SIGN and any(head[HEAD_BYTES : HEAD_BYTES + 4])


def read_readable(
    topic: str, messages: Iterable[StampedMessage], read: Callable[[list[StampedMessage]], Read]
) -> tuple[Read, tuple[Finding, ...]]:
    """Return the result of `read` for a topic's readable messages, and MSG-311 for the others.

    Raises the error of `read` if it can read none.
    """
    listed = list(messages)
    try:
        return read(listed), ()
    except (MessageLayoutError, ByteOrderError):
        good, findings = readable(topic, listed, read)
        return read(good), findings


def readable(
    topic: str, messages: Iterable[StampedMessage], read: Callable[[list[StampedMessage]], Read]
) -> tuple[list[StampedMessage], tuple[Finding, ...]]:
    """Return the messages of a topic that `read` can read, and MSG-311 for the others; all if it can read none.

    Then the error of `read` is more precise. Halves are tried separately, so that a few invalid messages cost little.
    """
    listed = list(messages)
    problems = _unreadable(listed, read, 0)
    if not problems or len(problems) == len(listed):
        return listed, ()
    first = min(problems)
    sentence = (
        f"{len(problems)} of {len(listed)} messages cannot be read and are left out (the first is number {first}: "
        f"{problems[first]})"
    )
    good = [message for at, message in enumerate(listed) if at not in problems]
    return good, (Finding("MSG-311", "warning", topic, sentence),)


def left_out_finding(
    topic: str, problems: Mapping[int, MessageProblem], stamps_ns: NDArray[np.int64]
) -> tuple[Finding, ...]:
    """Return MSG-311 for messages of a topic that are left out, () for none; `stamps_ns` are those of all its
    messages.
    """
    undamaged = {at: problem for at, problem in problems.items() if problem.code != DAMAGED}
    if not undamaged:
        return ()
    first = min(undamaged)
    sentence = (
        f"{len(undamaged)} of {len(stamps_ns)} messages are left out "
        f"(the first at {int(stamps_ns[first])} ns: {undamaged[first].reason})"
    )
    return (Finding("MSG-311", "warning", topic, sentence),)


def _unreadable(
    messages: list[StampedMessage], read: Callable[[list[StampedMessage]], Read], begin: int
) -> dict[int, str]:
    try:
        read(messages)
    except (MessageLayoutError, ByteOrderError) as error:
        if len(messages) == 1:
            return {begin: str(error)}
    except PoseValueError:
        return {}
    else:
        return {}
    half = len(messages) // 2
    return _unreadable(messages[:half], read, begin) | _unreadable(messages[half:], read, begin + half)


def majority(words: Iterable[str]) -> str:
    """Return the most frequent word, of several the first; "" without words."""
    return next((word for word, _count in Counter(words).most_common(1)), "")
