"""Message types of ROS 1 as ROS 2 knows them: names, fields, and how the bytes of one become those of the other.

**Conventions.** `package/Name` becomes `package/msg/Name`, `tf/tfMessage` the type that took its place. `seq` of a
header is on the wire of ROS 1 only. A type that is known here with the same wire is that one, so that `K` of a camera
is called `k`; any other stays as the recording describes it. A connection that describes nothing is of ROS 1 Noetic.
Source: wiki.ros.org/msg, common_msgs of ROS 1 and common_interfaces of ROS 2.
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

# Messages as ROS 1 serialises them, made into CDR of ROS 2 by a plan that is compiled once per type.
#
# **Conventions.** ROS 1 writes field after field without padding; strings and sequences begin with a u32 length. CDR
# aligns every number to its own size, counted from the body's first byte, and ends a string with NUL; the bytes of
# numbers are the same. So a message is copied in few pieces, and an array of numbers in one. A message whose lengths
# contradict its size is converted as far as it goes, and what is left over follows at its end: whoever decodes it
# refuses it, as CDR that was cut. Work and memory are bounded by the message's own bytes. Source: wiki.ros.org/msg;
# OMG DDSI-RTPS 2.5, 10.


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


RENAMED = {"tf/tfMessage": "tf2_msgs/TFMessage"}
TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
HEADER, SEQ = "std_msgs/msg/Header", Field("seq", "uint32")
DROPPED = Field("seq of ROS 1", "uint32")  # no name that a definition can have


class Ros2Type(NamedTuple):
    """What that is in ROS 2: package/msg/Name, and its definition as MCAP embeds it."""

    name: str
    schema: str


def ros2_type(told: Ros1Type) -> Ros2Type:
    """Raises: DefinitionRefusedError (no type, or none that is read), DefinitionMissingError (nothing describes it)."""
    name, types = _parsed(told)
    compiled(name, types)
    header = tuple(field for field in types.get(HEADER, ()) if field != SEQ)
    as_ros2 = {**types, HEADER: header}
    return Ros2Type(name, _schema(name, {key: _as_known(key, fields) for key, fields in as_ros2.items()}))


@lru_cache(maxsize=64)
def conversion_of(told: Ros1Type) -> Conversion:
    """Raises: as `ros2_type`."""
    name, types = _parsed(told)
    header = tuple(DROPPED if field == SEQ else field for field in types.get(HEADER, ()))
    return Conversion(compiled(name, {**types, HEADER: header}), DROPPED.name)


def _parsed(told: Ros1Type) -> tuple[str, dict[str, tuple[Field, ...]]]:
    """The name in ROS 2, and the fields on the wire of ROS 1."""
    name = full_name(RENAMED.get(told.name, told.name), told.name)
    types = parsed(told.definition.strip() or _noetic_text(name), name)
    return name, {**{time: registry().types[time] for time in TIMES}, **types}


def _as_known(name: str, fields: tuple[Field, ...]) -> tuple[Field, ...]:
    """With the names that are known here, where the wire is the same."""
    known = registry().types.get(name, ())
    return known if [_wire(field) for field in known] == [_wire(field) for field in fields] else fields


def _wire(field: Field) -> tuple[str, str, int]:
    return CODES.get(field.base, field.base), field.kind, field.length


def _schema(name: str, types: Types) -> str:
    """The type's own fields, then every other type that it uses in a section."""
    others = (f"{SECTION}\nMSG: {_short(other)}\n{_text(types[other])}" for other in _used(name, types))
    return "\n".join([_text(types[name]), *others])


def _used(name: str, types: Types) -> Iterator[str]:
    """The types that a type holds, once each."""
    waiting, seen = [name], {name, *TIMES}
    while waiting:
        found = dict.fromkeys(field.base for field in types[waiting.pop()] if field.base in types)
        fresh = [base for base in found if base not in seen]
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
    """How ROS 1 Noetic describes a type. Raises: DefinitionMissingError."""
    if name not in _noetic().fielddefs:
        raise DefinitionMissingError(name, PACKAGES)
    return _noetic().generate_msgdef(name, ros_version=1)[0]


@cache
def _noetic() -> Typestore:
    return get_typestore(Stores.ROS1_NOETIC)


# The topics of a ROS 1 bag under their types in ROS 2, and why one of them is left unread.
#
# **Conventions.** A topic that several publishers wrote is one, if they describe it alike. MSG-307: its definition
# cannot be read; BAG-020: it has none, and none is known; BAG-012: its publishers contradict each other.

# Definitions are parsed; a hostile recording may declare any number of types.
MOST_TYPES = 500
UNREAD = "ros1"


def described(
    connections: Sequence[Ros1Connection], counts: Mapping[str, int]
) -> tuple[tuple[Topic, ...], tuple[Finding, ...]]:
    """Topics by name, `counts` messages each, and a finding for each that is left unread; its encoding is "ros1"."""
    told = dict.fromkeys(connection.type for connection in connections)
    known = {one: _read(one) for one in islice(told, MOST_TYPES)}
    types: dict[str, dict[Ros1Type, None]] = {}
    for connection in connections:
        types.setdefault(connection.topic, {})[connection.type] = None
    topics, findings = [], list[Finding]()
    for name, listed in sorted(types.items()):
        found = _agreed([known.get(one, _TOO_MANY) for one in listed])
        if isinstance(found, Finding):
            findings.append(Finding(found.code, found.severity, name, found.message))
            topics.append(Topic(name, next(iter(listed)).name, counts[name], "", UNREAD))
        else:
            topics.append(Topic(name, found.name, counts[name], found.schema))
    return tuple(topics), tuple(findings)


_TOO_MANY = Finding("MSG-307", "warning", "", f"The recording has more than {MOST_TYPES} types; this one is not read.")


def _read(told: Ros1Type) -> Ros2Type | Finding:
    """The type in ROS 2, or why it is none."""
    try:
        return ros2_type(told)
    except DefinitionMissingError as error:
        message = f"The bag has no definition of {told.name!r}, nor has ROS 1 Noetic: the topic is not read."
        return Finding(error.code, "warning", "", message)
    except DefinitionRefusedError as error:
        return Finding(error.code, "warning", "", str(error))


def _agreed(found: Sequence[Ros2Type | Finding]) -> Ros2Type | Finding:
    first, *others = found
    for other in others:
        if isinstance(first, Ros2Type) and isinstance(other, Ros2Type) and other != first:
            message = f"Its publishers use the types {first.name} and {other.name}, or define them differently."
            return Finding("BAG-012", "warning", "", message)
    return next((one for one in found if isinstance(one, Finding)), first)
