"""Protocol buffers read by the FileDescriptorSet that comes with them, slowly and plainly.

A message becomes a dict of the fields that are there. Source: protobuf.dev, "Encoding"; descriptor.proto (proto3).
"""

import struct
from dataclasses import dataclass
from typing import Any

DOUBLE, FIXED32, BOOL, STRING, MESSAGE, BYTES, ENUM = 1, 7, 8, 9, 11, 12, 14
NAMES = {1: "double", 2: "float", 3: "int64", 5: "int32", 7: "fixed32", 8: "bool", 9: "string", 11: "message"}
NAMES |= {12: "bytes", 13: "uint32", 14: "enum"}
REPEATED = 3


@dataclass(frozen=True)
class Field:
    name: str
    number: int
    kind: int
    type_name: str
    is_repeated: bool

    def __str__(self) -> str:
        named = self.type_name.lstrip(".") or NAMES[self.kind]
        return f"{'repeated ' if self.is_repeated else ''}{named} {self.name} = {self.number}"


Messages = dict[str, dict[int, Field]]


def varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        value |= (data[at] & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if data[at - 1] < 0x80:
            return value, at


def records(data: bytes) -> list[tuple[int, int, Any]]:
    """(field number, wire type, value) in order; the whole message must be made of them."""
    found, at = [], 0
    while at < len(data):
        tag, at = varint(data, at)
        wire = tag & 7
        if wire == 0:
            value, at = varint(data, at)
        elif wire == 2:
            length, at = varint(data, at)
            value, at = data[at : at + length], at + length
        else:
            size = {1: 8, 5: 4}[wire]
            value, at = data[at : at + size], at + size
        found.append((tag >> 3, wire, value))
    assert at == len(data)
    return found


def messages_of(descriptor_set: bytes) -> Messages:
    """By full name, of every file in the set: their messages, and those within them."""
    found: Messages = {}
    for _, _, file in records(descriptor_set):
        parts = records(file)
        package = next((value.decode() for number, _, value in parts if number == 2), "")
        for number, _, value in parts:
            if number == 4:
                _add_message(value, package, found)
    return found


def _add_message(descriptor: bytes, scope: str, found: Messages) -> None:
    parts = records(descriptor)
    name = f"{scope}.{next(value.decode() for number, _, value in parts if number == 1)}"
    fields = [_field(value) for number, _, value in parts if number == 2]
    found[name] = {field.number: field for field in fields}
    for number, _, value in parts:
        if number == 3:
            _add_message(value, name, found)


def _field(descriptor: bytes) -> Field:
    parts = {number: value for number, _, value in records(descriptor)}
    type_name = parts.get(6, b"").decode()
    return Field(parts[1].decode(), parts[3], parts[5], type_name, parts.get(4) == REPEATED)


def decoded(data: bytes, name: str, messages: Messages) -> dict[str, Any]:
    """One message; a field that its schema does not know, or that comes twice though it may not, is an error."""
    values: dict[str, Any] = {}
    for number, wire, raw in records(data):
        field = messages[name][number]
        if field.is_repeated:
            values.setdefault(field.name, []).extend(_values(field, wire, raw, messages))
        else:
            assert field.name not in values
            (values[field.name],) = _values(field, wire, raw, messages)
    return values


def _values(field: Field, wire: int, raw: Any, messages: Messages) -> list[Any]:
    if field.kind == MESSAGE:
        return [decoded(raw, field.type_name.lstrip("."), messages)]
    if field.kind == STRING:
        return [raw.decode()]
    if field.kind == BYTES:
        return [raw]
    if field.kind in (DOUBLE, FIXED32):
        return [value for (value,) in struct.iter_unpack("<d" if field.kind == DOUBLE else "<I", raw)]
    assert wire == 0, "packed varints do not occur in these messages"
    return [bool(raw) if field.kind == BOOL else raw]
