"""ROS 1 message types in ROS 2: names, fields, and the conversion of their bytes.

**Conventions.** `package/Name` becomes `package/msg/Name`, `tf/tfMessage` the type that replaced it. Only ROS 1 has
`seq` of a header on the wire. A type with the wire of a known one becomes that one, so that `K` of a camera is called
`k`; any other type stays as described in the recording. A connection without a description is of ROS 1 Noetic. Source:
wiki.ros.org/msg, common_msgs of ROS 1 and common_interfaces of ROS 2.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property, lru_cache
from itertools import islice
from struct import Struct
from typing import NamedTuple, Protocol

from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from stone.findings import Finding
from stone_recordings.bags.errors import DefinitionMissingError
from stone_recordings.bags.message_store import Topic
from stone_recordings.bags.ros1.catalogue import Ros1Connection, Ros1Type
from stone_recordings.messages.errors import DefinitionRefusedError
from stone_recordings.messages.types.definition import CODES, EMPTY_FIELD, Field, Types, full_name, parsed
from stone_recordings.messages.types.definitions_beside import SECTION
from stone_recordings.messages.types.plan import Leaf, Node, Repeat, TextNode, compiled
from stone_recordings.messages.types.registry import PACKAGES, registry

# Conversion of serialised ROS 1 messages into CDR of ROS 2, by a plan compiled once per type. ROS 1 writes field after
# field without padding; strings and sequences start with a u32 length. CDR aligns every number to its own size, counted
# from the body's first byte, and ends a string with NUL; the bytes of numbers are the same. So a message is copied in
# few pieces, and an array of numbers in one. If a message's lengths contradict its size, it is converted up to the
# fault and the rest is appended: decoders refuse it as cut CDR. Work and memory are bounded by the message's own bytes.
# Source: wiki.ros.org/msg; OMG DDSI-RTPS 2.5, 10.


ENCAPSULATION = b"\0\1\0\0"  # little-endian plain CDR
STRICTEST = 8  # the largest alignment: only the written size modulo this matters
# The limit of elements that are copied one by one; no message has more, and the rest is left out.
MOST_ELEMENTS = 1 << 18
# CDR takes at most twice the bytes of ROS 1, except for empty messages, which take none there.
GROWTH, GROWTH_BYTES = 2, 1 << 16
UNBOUNDED = 1 << 62
_U32 = Struct("<I")


class Converted(NamedTuple):
    """CDR, and the number of the message's bytes in it."""

    payload: memoryview
    read_bytes: int


class Conversion:
    """The conversion of the messages of one type."""

    def __init__(self, plan: Sequence[Node], dropped: str) -> None:
        self._steps = tuple(_steps(plan, dropped))

    def of_message(self, source: memoryview) -> memoryview:
        """Convert the whole message."""
        writer = self._written(source, UNBOUNDED)
        if writer.is_done:
            writer.body += source[writer.at :]
        return memoryview(writer.body).toreadonly()

    def of_head(self, source: memoryview, most_bytes: int) -> Converted:
        """Convert at least `most_bytes`, or as much as `source` allows, which may end before the message does."""
        writer = self._written(source, most_bytes)
        return Converted(memoryview(writer.body).toreadonly(), min(writer.at, len(source)))

    def _written(self, source: memoryview, most_bytes: int) -> "_CdrWriter":
        writer = _CdrWriter(source, min(most_bytes, GROWTH * len(source) + GROWTH_BYTES))
        try:
            for step in self._steps:
                step.write(writer)
            writer.is_done = True
        except _WrittenError:
            pass  # the written part is the result
        return writer


class _WrittenError(Exception):
    """The message ends before its fields do, or the requested size is written."""


@dataclass(slots=True)
class _CdrWriter:
    """Reads `source` from `at` on and writes `body`, up to `most` bytes and the end of their piece."""

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
        """Copy bytes. Raises: _WrittenError."""
        part = self.source[self.at : self.at + count]
        self.body += part
        self.at += len(part)
        if len(part) < count or len(self.body) >= self.most:
            raise _WrittenError

    def length(self, extra: int = 0) -> int:
        """Read a length, and write it increased by `extra`. Raises: _WrittenError."""
        self.zeros(-self.phase % _U32.size)
        if len(self.source) - self.at < _U32.size:
            raise _WrittenError
        count = int(_U32.unpack_from(self.source, self.at)[0])
        self.at += _U32.size
        self.body += _U32.pack(min(count + extra, 0xFFFFFFFF))
        return count

    def count_element(self) -> None:
        """Count an element. Raises: _WrittenError."""
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
    """`source_bytes` of ROS 1 are `cdr_bytes` of CDR: equal, or none, or zeros for none."""

    source_bytes: int
    cdr_bytes: int
    alignment: int


class _Piece(NamedTuple):
    """The numbers of zeros to write, of bytes to skip, and of bytes to copy."""

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
    """`length` elements, or the number in the message (None)."""

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
    """Yield steps; successive numbers are one step."""
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


RENAMED = {"tf/tfMessage": "tf2_msgs/TFMessage"}
TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
HEADER, SEQ = "std_msgs/msg/Header", Field("seq", "uint32")
DROPPED = Field("seq of ROS 1", "uint32")  # no valid name in a definition


class Ros2Type(NamedTuple):
    """A type in ROS 2: package/msg/Name, and its definition in MCAP's form."""

    name: str
    schema: str


def ros2_type(told: Ros1Type) -> Ros2Type:
    """Return the type in ROS 2. Raises: DefinitionRefusedError (an invalid type), DefinitionMissingError (no
    definition).
    """
    name, types = _parsed(told)
    compiled(name, types)
    header = tuple(field for field in types.get(HEADER, ()) if field != SEQ)
    as_ros2 = {**types, HEADER: header}
    return Ros2Type(name, _schema(name, {key: _as_known(key, fields) for key, fields in as_ros2.items()}))


@lru_cache(maxsize=64)
def conversion_of(told: Ros1Type) -> Conversion:
    """Return the conversion. Raises: as `ros2_type`."""
    name, types = _parsed(told)
    header = tuple(DROPPED if field == SEQ else field for field in types.get(HEADER, ()))
    return Conversion(compiled(name, {**types, HEADER: header}), DROPPED.name)


def _parsed(declared: Ros1Type) -> tuple[str, dict[str, tuple[Field, ...]]]:
    """Return the name in ROS 2, and the fields on the wire of ROS 1."""
    name = full_name(RENAMED.get(declared.name, declared.name), declared.name)
    types = parsed(declared.definition.strip() or _noetic_text(name), name)
    return name, {**{time: registry().types[time] for time in TIMES}, **types}


def _as_known(name: str, fields: tuple[Field, ...]) -> tuple[Field, ...]:
    """Return the fields with the known names if the wire is the same."""
    known = registry().types.get(name, ())
    return known if [_wire(field) for field in known] == [_wire(field) for field in fields] else fields


def _wire(field: Field) -> tuple[str, str, int]:
    return CODES.get(field.base, field.base), field.kind, field.length


def _schema(name: str, types: Types) -> str:
    """Return the type's own fields, then every other type in use in a section."""
    others = (f"{SECTION}\nMSG: {_short(other)}\n{_text(types[other])}" for other in _used(name, types))
    return "\n".join([_text(types[name]), *others])


def _used(name: str, types: Types) -> Iterator[str]:
    """Yield the types that a type holds, once each."""
    waiting, seen = [name], {name, *TIMES}
    while waiting:
        bases = dict.fromkeys(field.base for field in types[waiting.pop()] if field.base in types)
        fresh = [base for base in bases if base not in seen]
        yield from fresh
        seen.update(fresh)
        waiting += fresh


def _text(fields: Sequence[Field]) -> str:
    return "".join(f"{_short(field.base)}{_suffix(field)} {field.name}\n" for field in fields)


def _suffix(field: Field) -> str:
    return {"one": "", "sequence": "[]", "array": f"[{field.length}]"}[field.kind]


def _short(name: str) -> str:
    return name.replace("/msg/", "/")


def _noetic_text(name: str) -> str:
    """Return ROS 1 Noetic's definition of a type. Raises: DefinitionMissingError."""
    if name not in _noetic().fielddefs:
        raise DefinitionMissingError(name, PACKAGES)
    return _noetic().generate_msgdef(name, ros_version=1)[0]


@cache
def _noetic() -> Typestore:
    return get_typestore(Stores.ROS1_NOETIC)


# The topics of a ROS 1 bag under their types in ROS 2, and the reasons for unread ones. Several publishers form one
# topic if their definitions agree. MSG-307: the definition cannot be read; BAG-020: there is none, and none is known;
# BAG-012: the publishers contradict each other.

# Definitions are parsed; a hostile recording may declare any number of types.
MOST_TYPES = 500
UNREAD = "ros1"


def described(
    connections: Sequence[Ros1Connection], counts: Mapping[str, int]
) -> tuple[tuple[Topic, ...], tuple[Finding, ...]]:
    """Return topics by name, `counts` messages each, and a finding for each unread one, whose encoding is "ros1"."""
    declared = dict.fromkeys(connection.type for connection in connections)
    known = {declared_type: _read(declared_type) for declared_type in islice(declared, MOST_TYPES)}
    types: dict[str, dict[Ros1Type, None]] = {}
    for connection in connections:
        types.setdefault(connection.topic, {})[connection.type] = None
    topics, findings = [], list[Finding]()
    for name, listed in sorted(types.items()):
        agreed = _agreed([known.get(declared_type, _TOO_MANY) for declared_type in listed])
        if isinstance(agreed, Finding):
            findings.append(Finding(agreed.code, agreed.severity, name, agreed.message))
            topics.append(Topic(name, next(iter(listed)).name, counts[name], "", UNREAD))
        else:
            topics.append(Topic(name, agreed.name, counts[name], agreed.schema))
    return tuple(topics), tuple(findings)


_TOO_MANY = Finding("MSG-307", "warning", "", f"The recording has more than {MOST_TYPES} types; this one is not read.")


def _read(declared: Ros1Type) -> Ros2Type | Finding:
    """Return the type in ROS 2, or a finding with the reason."""
    try:
        return ros2_type(declared)
    except DefinitionMissingError as error:
        message = f"The bag has no definition of {declared.name!r}, nor has ROS 1 Noetic: the topic is not read."
        return Finding(error.code, "warning", "", message)
    except DefinitionRefusedError as error:
        return Finding(error.code, "warning", "", str(error))


def _agreed(types: Sequence[Ros2Type | Finding]) -> Ros2Type | Finding:
    first, *others = types
    for other in others:
        if isinstance(first, Ros2Type) and isinstance(other, Ros2Type) and other != first:
            message = f"Its publishers use the types {first.name} and {other.name}, or define them differently."
            return Finding("BAG-012", "warning", "", message)
    return next((each for each in types if isinstance(each, Finding)), first)
