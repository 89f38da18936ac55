"""What rosbags reads, laid out as our columns are: the slow, obvious way."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stone_recordings.messages.types.registry import typestore
from stone_recordings.messages.types.table import MessageTable, Ragged


@dataclass(frozen=True)
class Message:
    payload: memoryview


def wire(payloads: Sequence[bytes]) -> list[Message]:
    return [Message(memoryview(payload)) for payload in payloads]


def read_by_rosbags(type_name: str, messages: Sequence[Message]) -> list[Any]:
    return [typestore().deserialize_cdr(message.payload, type_name) for message in messages]


def assert_same(table: MessageTable, theirs: Sequence[Any]) -> None:
    """Every column equals what its path leads to in every message, bit for bit."""
    assert table.count == len(theirs)
    for name, column in table.columns.items():
        expected = [_follow(message, name.split(".")) for message in theirs]
        assert_equal(column, expected, name)


def _follow(value: Any, path: Sequence[str]) -> Any:
    """Attributes by name; a list on the way stays a list of what its elements lead to."""
    if isinstance(value, list):
        return [_follow(element, path) for element in value]
    if not path:
        return value
    return _follow(getattr(value, path[0]), path[1:])


def assert_equal(column: Any, expected: Sequence[Any], name: str) -> None:
    if isinstance(column, Ragged):
        counts = [len(value) for value in expected]
        assert np.diff(column.offsets).tolist() == counts, name
        assert_equal(column.values, [element for value in expected for element in value], name)
    elif isinstance(column, list):
        assert column == list(expected), name
    else:
        theirs = np.array(expected, column.dtype).reshape(column.shape)
        assert np.ascontiguousarray(column).tobytes() == theirs.tobytes(), name


def damaged_in_turn(whole: bytes, read: Callable[[bytes], Any], errors: tuple[type[Exception], ...]) -> int:
    """Read `whole` cut at every length and with every byte raised; gives how many of those were refused."""
    refused = 0
    for at in range(len(whole)):
        for damaged in (whole[:at], whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :]):
            try:
                read(damaged)
            except errors:
                refused += 1
    return refused
