"""Messages as ROS 1 serialises them, made into CDR of ROS 2 by a plan that is compiled once per type.

**Conventions.** ROS 1 writes field after field without padding; strings and sequences begin with a u32 length. CDR
aligns every number to its own size, counted from the body's first byte, and ends a string with NUL; the bytes of
numbers are the same. So a message is copied in few pieces, and an array of numbers in one. A message whose lengths
contradict its size is converted as far as it goes, and what is left over follows at its end: whoever decodes it refuses
it, as CDR that was cut. Work and memory are bounded by the message's own bytes. Source: wiki.ros.org/msg; OMG DDSI-RTPS
2.5, 10.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from struct import Struct
from typing import NamedTuple, Protocol

from stone_recordings.messages.types.definition import EMPTY_FIELD
from stone_recordings.messages.types.plan import Leaf, Node, Repeat, TextNode

ENCAPSULATION = b"\0\1\0\0"  # little-endian plain CDR
STRICTEST = 8  # the largest alignment: what was written before matters modulo this
# Elements that are copied one by one; of more than any message has, the rest is left out.
MOST_ELEMENTS = 1 << 18
# CDR takes at most twice the bytes of ROS 1 but for empty messages, which take none there.
GROWTH, GROWTH_BYTES = 2, 1 << 16
UNBOUNDED = 1 << 62
_U32 = Struct("<I")


class Converted(NamedTuple):
    """CDR, and how many bytes of the message it was made of."""

    payload: memoryview
    read_bytes: int


class Conversion:
    """Of the messages of one type."""

    def __init__(self, plan: Sequence[Node], dropped: str) -> None:
        self._steps = tuple(_steps(plan, dropped))

    def of_message(self, source: memoryview) -> memoryview:
        """The whole message."""
        writer = self._written(source, UNBOUNDED)
        if writer.is_done:
            writer.body += source[writer.at :]
        return memoryview(writer.body).toreadonly()

    def of_head(self, source: memoryview, most_bytes: int) -> Converted:
        """At least `most_bytes` of it, or as much as `source`, which may end before the message does, has of it."""
        writer = self._written(source, most_bytes)
        return Converted(memoryview(writer.body).toreadonly(), min(writer.at, len(source)))

    def _written(self, source: memoryview, most_bytes: int) -> "_CdrWriter":
        writer = _CdrWriter(source, min(most_bytes, GROWTH * len(source) + GROWTH_BYTES))
        try:
            for step in self._steps:
                step.write(writer)
            writer.is_done = True
        except _WrittenError:
            pass  # what is written is what there is
        return writer


class _WrittenError(Exception):
    """The message ends before its fields do, or as much is written as was asked for."""


@dataclass(slots=True)
class _CdrWriter:
    """Reads `source` from `at` on and writes `body`, up to `most` bytes and the end of the piece that they end in."""

    source: memoryview
    most: int
    at: int = 0
    elements: int = 0
    is_done: bool = False
    body: bytearray = field(default_factory=lambda: bytearray(ENCAPSULATION))

    @property
    def phase(self) -> int:
        return (len(self.body) - len(ENCAPSULATION)) % STRICTEST

    def zeros(self, count: int) -> None:
        self.body += bytes(count)

    def copy(self, count: int) -> None:
        """Raises: _WrittenError."""
        part = self.source[self.at : self.at + count]
        self.body += part
        self.at += len(part)
        if len(part) < count or len(self.body) >= self.most:
            raise _WrittenError

    def length(self, extra: int = 0) -> int:
        """A length is read, and written with `extra` on it. Raises: _WrittenError."""
        self.zeros(-self.phase % _U32.size)
        if len(self.source) - self.at < _U32.size:
            raise _WrittenError
        count = int(_U32.unpack_from(self.source, self.at)[0])
        self.at += _U32.size
        self.body += _U32.pack(min(count + extra, 0xFFFFFFFF))
        return count

    def count_element(self) -> None:
        """Raises: _WrittenError."""
        self.elements += 1
        if self.elements > MOST_ELEMENTS or len(self.body) >= self.most:
            raise _WrittenError


class _CdrStep(Protocol):
    def write(self, writer: _CdrWriter) -> None: ...


class _Text:
    def write(self, writer: _CdrWriter) -> None:
        writer.copy(writer.length(extra=1))
        writer.zeros(1)


class _Number(NamedTuple):
    """`source_bytes` of ROS 1 are `cdr_bytes` of CDR: as many, or none, or zeros of none."""

    source_bytes: int
    cdr_bytes: int
    alignment: int


class _Piece(NamedTuple):
    """So many zeros are written, so many bytes passed over, so many copied."""

    zeros: int
    passed: int
    copied: int


class _Fixed:
    """Numbers in a row, laid out once for each phase."""

    def __init__(self, numbers: Sequence[_Number]) -> None:
        self._numbers = numbers
        self.source_bytes = sum(number.source_bytes for number in numbers)

    @cached_property
    def _layouts(self) -> tuple[tuple[_Piece, ...], ...]:
        return tuple(tuple(_pieces(self._numbers, phase)) for phase in range(STRICTEST))

    @cached_property
    def _is_solid(self) -> tuple[bool, ...]:
        """By phase: whether any number of elements from there on is one piece."""
        alone = [(_Piece(0, 0, self.source_bytes),) == layout for layout in self._layouts]
        return tuple(
            all(alone[(phase + n * self.source_bytes) % STRICTEST] for n in range(STRICTEST))
            for phase in range(STRICTEST)
        )

    def write(self, writer: _CdrWriter) -> None:
        for zeros, passed, copied in self._layouts[writer.phase]:
            writer.zeros(zeros)
            writer.at += passed
            writer.copy(copied)

    def write_many(self, writer: _CdrWriter, count: int) -> None:
        while count and not self._is_solid[writer.phase]:
            writer.count_element()
            self.write(writer)
            count -= 1
        if count:
            writer.copy(count * self.source_bytes)


@dataclass(frozen=True)
class _Repeated:
    """`length` elements, or as many as the message says (None)."""

    length: int | None
    element: tuple[_CdrStep, ...]

    def write(self, writer: _CdrWriter) -> None:
        count = writer.length() if self.length is None else self.length
        match self.element:
            case (_Fixed() as numbers,):
                numbers.write_many(writer, count)
            case _:
                for _ in range(count):
                    writer.count_element()
                    for step in self.element:
                        step.write(writer)


def _steps(nodes: Sequence[Node], dropped: str) -> Iterator[_CdrStep]:
    """Numbers that follow each other are one step."""
    numbers: list[_Number] = []
    for node in nodes:
        if isinstance(node, Leaf):
            numbers.append(_number(node, dropped))
            continue
        if numbers:
            yield _Fixed(numbers)
            numbers = []
        yield _Text() if isinstance(node, TextNode) else _repeated(node, dropped)
    if numbers:
        yield _Fixed(numbers)


def _repeated(node: Repeat, dropped: str) -> _Repeated:
    return _Repeated(node.length, tuple(_steps(node.element, dropped)))


def _number(leaf: Leaf, dropped: str) -> _Number:
    if leaf.name.endswith(EMPTY_FIELD):
        return _Number(0, 1, 1)
    return _Number(leaf.size_bytes, 0 if leaf.name.endswith(dropped) else leaf.size_bytes, leaf.code.itemsize)


def _pieces(numbers: Sequence[_Number], phase: int) -> Iterator[_Piece]:
    zeros = passed = copied = 0
    for number in numbers:
        padding = -phase % number.alignment if number.cdr_bytes else 0
        if copied and (padding or number.source_bytes != number.cdr_bytes):
            yield _Piece(zeros, passed, copied)
            zeros = passed = copied = 0
        zeros += padding
        phase += padding + number.cdr_bytes
        if number.source_bytes == number.cdr_bytes:
            copied += number.source_bytes
        else:
            zeros, passed = zeros + number.cdr_bytes, passed + number.source_bytes
    yield _Piece(zeros, passed, copied)
