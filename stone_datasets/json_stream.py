"""A streaming JSON reader: yields the values of a file of any size and formatting one by one.

**Conventions.** At most one value and one piece of the file are in memory. The reader steps through enclosing values
(the list of rows, the objects of annotations.json); `json` decodes the values inside.
"""

import codecs
import json
import re
from collections.abc import Iterator
from typing import Any

from stone_datasets.faults import DatasetFaultError, DatasetPlace, quoted
from stone_exports.files import DamagedExportError, ExportFileSpan

LONGEST_VALUE = 2**20  # characters
LONGEST_ATOM = 16  # -Infinity, an escape, or a possibly unfinished number
MOST_ROWS = 1 << 26
SPACE = re.compile(r"[ \t\n\r]*")
DECODER = json.JSONDecoder()
MARK = "\ufeff"
WITH_MARK = "it starts with a byte order mark: write it with encoding='utf-8', not 'utf-8-sig'"
OF_PYTHON = ("'", "None", "True", "False", "array(")
AS_REPR = "it is Python's repr: write it with json.dump"


class JsonStream:
    """The characters of a file, read once; `written` is the text of the last value.

    Every method raises a `DatasetFaultError` of the file.
    """

    def __init__(self, span: ExportFileSpan) -> None:
        self.name = span.name
        self._pieces, self._text, self._at, self._is_whole = _decoded(span), "", 0, False
        self.written = ""

    def peek(self) -> str:
        """Return the next character that is not white space, "" at the end."""
        while True:
            self._at = SPACE.match(self._text, self._at).end()  # type: ignore[union-attr]
            if self._at < len(self._text):
                return self._text[self._at]
            if self._is_whole:
                return ""
            self._read_on()

    def take(self, wanted: str) -> bool:
        """Return whether the next character is `wanted`, and skip it if so."""
        is_next = self.peek() == wanted
        self._at += is_next
        return is_next

    def expect(self, wanted: str) -> None:
        if not self.take(wanted):
            raise self.malformed(f"expected {wanted!r} instead of {quoted(self.peek())}")

    def value(self, row: int | None = None) -> Any:
        """Return the value that starts here."""
        self.peek()
        while True:
            try:
                value, end = DECODER.raw_decode(self._text, self._at)
            except RecursionError as error:
                raise self.malformed("values are nested too deeply", row) from error
            except ValueError as error:
                if not self._may_be_cut(error):
                    raise self._malformed_at(error, row) from error
                value, end = error, len(self._text)
            if end - self._at > LONGEST_VALUE:
                raise DatasetFaultError(
                    "DST-014", DatasetPlace(self.name, row), f"it has more than {LONGEST_VALUE} characters"
                )
            if self._is_whole or end < len(self._text):  # otherwise it may continue in the next piece
                break
            self._read_on()
        if isinstance(value, ValueError):
            raise self._malformed_at(value, row) from value
        self.written, self._at = self._text[self._at : end], end
        return value

    def items(self) -> Iterator[str]:
        """Yield the keys of the object that starts here; the caller reads each value before the next key."""
        self.expect("{")
        while not self.take("}"):
            key = self.value()
            if not isinstance(key, str):
                raise self.malformed(f"{quoted(key)} is not a key")
            self.expect(":")
            yield key
            self.next_or("}")

    def next_or(self, closing: str) -> None:
        """Skip the comma before another value, unless the enclosing value is closed here."""
        if self.peek() != closing:
            self.expect(",")
            if self.peek() == closing:
                raise self.malformed(f"{quoted(closing)} follows a comma")

    def end(self) -> None:
        if self.peek():
            raise self.malformed(f"{quoted(self.peek())} follows the end")

    def malformed(self, what: str, row: int | None = None, likely: str = "") -> DatasetFaultError:
        return DatasetFaultError("DST-011", DatasetPlace(self.name, row), what, likely)

    def _malformed_at(self, error: ValueError, row: int | None) -> DatasetFaultError:
        """Return the decoder's fault; the hint detects a cut-off file and Python's repr."""
        at = getattr(error, "pos", 0)
        is_cut = self._is_whole and ("Unterminated" in str(error) or not self._text[at : at + 2].strip())
        is_repr = self._text.startswith(OF_PYTHON, at)
        likely = AS_REPR if is_repr else "" if is_cut else "json.dump writes standard JSON"
        return self.malformed(str(error)[:80], row, likely)

    def _may_be_cut(self, error: ValueError) -> bool:
        """Return whether the end of a piece may cause this error: an unfinished text, or one of the last characters."""
        at = getattr(error, "pos", 0)
        return "Unterminated" in str(error) or at > len(self._text) - LONGEST_ATOM

    def _read_on(self) -> None:
        piece = next(self._pieces, None)
        self._is_whole = piece is None
        self._text, self._at = self._text[self._at :] + (piece or ""), 0


def json_rows(span: ExportFileSpan, stream: JsonStream | None = None) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield the rows of a table with their number from 1; pass `stream` to also use their `written` text.

    Raises a `DatasetFaultError` if the table is not a list of objects.
    """
    stream = stream or JsonStream(span)
    if not stream.peek():
        raise stream.malformed("it is empty")
    if stream.peek() != "[":
        likely = WITH_MARK if stream.peek() == MARK else ""
        raise DatasetFaultError("DST-012", DatasetPlace(span.name), f"it starts with {quoted(stream.peek())}", likely)
    stream.expect("[")
    row = 0
    while not stream.take("]"):
        row += 1
        value = stream.value(row)
        if not isinstance(value, dict):
            raise DatasetFaultError("DST-013", DatasetPlace(span.name, row), f"it is {quoted(value)}")
        if row > MOST_ROWS:
            raise DatasetFaultError("DST-005", DatasetPlace(span.name), f"it has more than {MOST_ROWS} rows")
        yield row, value
        stream.next_or("]")
    stream.end()


def _decoded(span: ExportFileSpan) -> Iterator[str]:
    """Yield pieces of text. Raises a `DatasetFaultError`."""
    decoder = codecs.getincrementaldecoder("utf-8")()
    try:
        for piece in span.pieces():
            yield decoder.decode(piece)
        yield decoder.decode(b"", final=True)
    except UnicodeDecodeError as error:
        is_utf16 = error.object[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
        likely = "it is UTF-16, as PowerShell's `>` writes" if is_utf16 else "it has another encoding"
        raise DatasetFaultError("DST-011", DatasetPlace(span.name), "it is not UTF-8", likely) from error
    except DamagedExportError as error:
        what = f"{error.why}; did another program truncate it during reading?"
        raise DatasetFaultError("DST-011", DatasetPlace(span.name), what) from error
