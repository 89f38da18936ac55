"""Rows as text, in the format of PostgreSQL's `COPY … (FORMAT text)`, read and written without PostgreSQL.

**Conventions.** One line a row, values separated by tabs, `\\N` for null; backslash, tab and line ends within a value
are escaped. Booleans are t and f, bytes `\\x` and hex, JSON its text as it was stored, to the letter.
Source: PostgreSQL documentation, COPY, "Text Format".
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal

from sqlalchemy import JSON, Boolean, Column, Float, Integer, LargeBinary, String

Kind = Literal["text", "integer", "float", "boolean", "json", "bytes"]

NULL = "\\N"
_ESCAPED = str.maketrans({"\\": "\\\\", "\t": "\\t", "\n": "\\n", "\r": "\\r"})
_SIGNS = {"t": "\t", "n": "\n", "r": "\r", "b": "\b", "f": "\f", "v": "\v", "\\": "\\"}
_ESCAPE = re.compile(r"\\(.)", re.DOTALL)
_KINDS: tuple[tuple[type, Kind], ...] = (
    (Boolean, "boolean"),
    (JSON, "json"),
    (LargeBinary, "bytes"),
    (Integer, "integer"),
    (Float, "float"),
    (String, "text"),
)


def kind_of(column: Column[Any]) -> Kind:
    """The text format of the column's values."""
    return next(kind for type_, kind in _KINDS if isinstance(column.type, type_))


def line_of(row: Iterable[Any], kinds: Sequence[Kind]) -> str:
    """A row as SQLite's driver gives it, as a line."""
    return "\t".join(NULL if value is None else _WRITTEN[kind](value) for value, kind in zip(row, kinds, strict=True))


def row_of(line: str, kinds: Sequence[Kind]) -> list[Any]:
    """A line's row as SQLite's driver takes it. Raises `ValueError` for what is no such line."""
    fields = line.split("\t")
    return [
        None if field == NULL else _READ[kind](_unescaped(field)) for field, kind in zip(fields, kinds, strict=True)
    ]


def lines_of(pieces: Iterable[bytes]) -> Iterator[str]:
    """The lines of a file that comes in pieces."""
    rest = b""
    for piece in pieces:
        *lines, rest = (rest + piece).split(b"\n")
        for line in lines:
            yield line.decode("utf-8")
    if rest:
        raise ValueError("the last line has no end")


def _unescaped(field: str) -> str:
    return _ESCAPE.sub(lambda match: _SIGNS.get(match[1], match[1]), field) if "\\" in field else field


def _text(value: Any) -> str:
    return str(value).translate(_ESCAPED)


_WRITTEN: Mapping[Kind, Callable[[Any], str]] = {
    "text": _text,
    "json": _text,
    "integer": lambda value: str(int(value)),
    "float": lambda value: repr(float(value)),
    "boolean": lambda value: "t" if value else "f",
    "bytes": lambda value: "\\\\x" + bytes(value).hex(),
}
_READ: Mapping[Kind, Callable[[str], Any]] = {
    "text": str,
    "json": str,
    "integer": int,
    "float": float,
    "boolean": lambda field: int(field == "t"),
    "bytes": lambda field: bytes.fromhex(field.removeprefix("\\x")),
}
