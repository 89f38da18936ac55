"""Message definitions (`.msg`, ros2msg) as values: strict, bounded, nothing executed.

**Conventions.** A type is "package/msg/Name". A field is one value, a fixed array or a sequence of a primitive or of
another type. Bounds of strings and sequences are read and dropped, since they do not change the wire. Definitions are
untrusted: syntax, names and every size are checked. Source: ROS 2 interface definition, REP 9 (rosidl).
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from stone_recordings.messages.errors import DefinitionRefusedError

# The longest built-in definition has 4,000 characters without comments.
MOST_CHARACTERS = 1 << 18
MOST_TYPES = 512
MOST_FIELDS = 1024
# The longest known fixed array has 1,500 elements (a Pandar packet).
MOST_ELEMENTS = 1 << 20
# An empty message has one byte on the wire, which rosidl gives this name.
EMPTY_FIELD = "structure_needs_at_least_one_member"

CODES = {
    "bool": "u1", "byte": "u1", "char": "u1", "uint8": "u1", "int8": "i1", "uint16": "<u2", "int16": "<i2",
    "uint32": "<u4", "int32": "<i4", "uint64": "<u8", "int64": "<i8", "float32": "<f4", "float64": "<f8",
}  # fmt: skip
PRIMITIVES = frozenset({*CODES, "string", "wstring"})
_OLD_NAMES = {"time": "builtin_interfaces/msg/Time", "duration": "builtin_interfaces/msg/Duration"}
# Type, bound of a string, array, name; then the value of a constant (5), a default, or nothing.
_FIELD = re.compile(
    r"([A-Za-z][\w/]{0,200})(<=\d{1,9})?(\[(?:<=)?\d{0,9}\])?\s+([A-Za-z]\w{0,100})"
    r"(?:\s*(=).*|\s+[-+.\d\[\"'tTfF].*)?",
    re.ASCII,
)
_TYPE = re.compile(r"([a-z][a-z0-9_]{0,80})/(?:msg/)?([A-Za-z]\w{0,100})", re.ASCII)
_SEPARATOR = re.compile(r"={40,}")
_HEADING = re.compile(r"MSG:\s*(\S{1,200})")


@dataclass(frozen=True)
class Field:
    """`base` is a primitive or the full name of a type; `length` counts for arrays only."""

    name: str
    base: str
    kind: Literal["one", "array", "sequence"] = "one"
    length: int = 0


Types = Mapping[str, tuple[Field, ...]]


def full_name(name: str, where: str) -> str:
    """Return package/msg/Name for package/Name or package/msg/Name. Raises: DefinitionRefusedError."""
    match = _TYPE.fullmatch(name)
    if match is None:
        raise DefinitionRefusedError(where, f"{name[:60]!r} is not the name of a type (package/msg/Name)")
    return f"{match[1]}/msg/{match[2]}"


def parsed(text: str, type_name: str) -> dict[str, tuple[Field, ...]]:
    """Return the fields of `type_name`, and of every type after a line of "=" and "MSG: package/Name".

    Raises: DefinitionRefusedError (syntax, names, a duplicate name, more than any real definition holds).
    """
    if len(text) > MOST_CHARACTERS:
        raise DefinitionRefusedError(type_name, f"it has {len(text)} characters, the limit is {MOST_CHARACTERS}")
    types: dict[str, tuple[Field, ...]] = {}
    for name, lines in _sections(text, full_name(type_name, type_name)):
        fields = _fields(lines, name)
        if types.setdefault(name, fields) != fields:
            raise DefinitionRefusedError(type_name, f"{name} is defined twice, differently")
        if len(types) > MOST_TYPES:
            raise DefinitionRefusedError(type_name, f"it holds more than {MOST_TYPES} types")
    return types


def _sections(text: str, name: str) -> Iterator[tuple[str, list[str]]]:
    """Yield (type, its lines) in the order of the text."""
    lines: list[str] = []
    is_heading = False
    for line in text.splitlines():
        if _SEPARATOR.fullmatch(line.strip()):
            yield name, lines
            lines, is_heading = [], True
        elif is_heading and line.strip():
            match = _HEADING.fullmatch(line.strip())
            if match is None:
                raise DefinitionRefusedError(name, f"{line.strip()[:60]!r} follows a line of '=', 'MSG: …' is expected")
            name, is_heading = full_name(match[1], name), False
        else:
            lines.append(line)
    yield name, lines


def _fields(lines: list[str], type_name: str) -> tuple[Field, ...]:
    fields: dict[str, Field] = {}
    for line in lines:
        content = line.split("#", 1)[0].strip()
        if not content:
            continue
        match = _FIELD.fullmatch(content)
        if match is None:
            raise DefinitionRefusedError(type_name, f"{content[:60]!r} is neither a field nor a constant")
        if match[5]:
            continue  # a constant is not on the wire
        if match[4] in fields:
            raise DefinitionRefusedError(type_name, f"field {match[4]!r} is declared twice")
        fields[match[4]] = _field(match, type_name)
    if len(fields) > MOST_FIELDS:
        raise DefinitionRefusedError(type_name, f"it has {len(fields)} fields, the limit is {MOST_FIELDS}")
    return tuple(fields.values()) or (Field(EMPTY_FIELD, "uint8"),)


def _field(match: re.Match[str], type_name: str) -> Field:
    base = _base(match[1], type_name)
    if match[2] and base not in ("string", "wstring"):
        raise DefinitionRefusedError(type_name, f"{match[0].strip()[:60]!r} bounds a type that is not a string")
    inside = (match[3] or "").strip("[]")
    if not match[3]:
        return Field(match[4], base)
    if not inside or inside.startswith("<="):
        return Field(match[4], base, "sequence")
    if not 1 <= int(inside) <= MOST_ELEMENTS:
        raise DefinitionRefusedError(type_name, f"{match[4]!r} has {inside} elements, 1 to {MOST_ELEMENTS} are read")
    return Field(match[4], base, "array", int(inside))


def _base(written: str, type_name: str) -> str:
    if written in PRIMITIVES:
        return written
    if written == "Header":
        return "std_msgs/msg/Header"
    if written in _OLD_NAMES:
        return _OLD_NAMES[written]
    package = type_name.split("/", 1)[0]
    return full_name(written if "/" in written else f"{package}/{written}", type_name)
