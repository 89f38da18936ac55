"""Messages of any type → columns, compiled from the definition of the type.

**Conventions.** Columns (`Ragged`, `MessageTable`) are below; `stone_recordings.messages.types.cdr` is the wire format.
Messages of one layout are copied together; layouts are few, so copying dominates the cost.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.errors import MessageLayoutError
from stone_recordings.messages.batch import StampedMessage, payload_batches
from stone_recordings.messages.types.cdr import NS_PER_S, Sheet, sheets, text_of
from stone_recordings.messages.types.plan import Leaf, Node, Repeat, TextNode
from stone_recordings.messages.types.registry import Registry, registry
from stone_recordings.messages.types.sketch import PayloadPiece, Sketch, sketched

# Decoded messages as columns, by name and kind. A column is named by its dotted path ("header.stamp.sec"). Numbers
# outside of sequences are arrays (N,) or, for fixed arrays, (N, length); texts are lists of N; values in a sequence are
# `Ragged`, once for every sequence around them. Rows are in the order of the messages.


def as_doubles(values: NDArray[Any]) -> NDArray[np.float64]:
    """Convert to float64; a signalling NaN of a damaged message counts as any other NaN."""
    with np.errstate(invalid="ignore"):
        return values.astype(np.float64, copy=False)


@dataclass(frozen=True, eq=False)
class Ragged:
    """Element i of the level above has the values `offsets[i]:offsets[i + 1]`."""

    offsets: NDArray[np.int64]
    values: "Column"


Column = NDArray[Any] | list[str] | Ragged


@dataclass(frozen=True, eq=False)
class MessageTable:
    """N messages; `columns` has the requested leaves, by dotted path.

    A recording's own definition may lack a field or change its type, so a reader states the expected kind: every
    accessor raises MessageLayoutError if the column is of another kind.
    """

    type_name: str
    count: int
    columns: Mapping[str, Column]

    def numbers(self, name: str, length: int | None = None, kinds: str = "fiu") -> NDArray[Any]:
        """Return (N,), or (N, length) of a fixed array; `kinds` are numpy's, "iu" for whole numbers only."""
        column = self._column(name)
        shape = () if length is None else (length,)
        if not isinstance(column, np.ndarray) or column.shape[1:] != shape or column.dtype.kind not in kinds:
            single, many = ("a number", "numbers") if "f" in kinds else ("an integer", "integers")
            kind = single if length is None else f"an array of {length} {many}"
            raise MessageLayoutError(self.type_name, f"its definition does not declare {name} as {kind}")
        return column

    def vectors(self, name: str, axes: str = "xyz") -> NDArray[np.float64]:
        """Return (N, len(axes)) from the columns name.x, name.y, …"""
        columns = [self.numbers(f"{name}.{axis}") for axis in axes]
        return as_doubles(np.stack(columns, axis=1))

    def texts(self, name: str) -> list[str]:
        """Return one text per message."""
        column = self._column(name)
        if not isinstance(column, list):
            raise MessageLayoutError(self.type_name, f"its definition does not declare {name} as a string")
        return column

    def ragged(self, name: str) -> tuple[NDArray[np.int64], NDArray[Any]]:
        """Return the offsets (N + 1,) and numbers (M,) of a sequence."""
        column = self._column(name)
        if isinstance(column, Ragged) and isinstance(column.values, np.ndarray) and column.values.ndim == 1:
            return column.offsets, column.values
        raise MessageLayoutError(self.type_name, f"its definition does not declare {name} as a sequence of numbers")

    def ragged_texts(self, name: str) -> tuple[NDArray[np.int64], list[str]]:
        """Return the offsets (N + 1,) and texts (M) of a sequence."""
        column = self._column(name)
        if isinstance(column, Ragged) and isinstance(column.values, list):
            return column.offsets, column.values
        raise MessageLayoutError(self.type_name, f"its definition does not declare {name} as a sequence of strings")

    def stamps_ns(self, name: str = "header.stamp") -> NDArray[np.int64]:
        sec, nanosec = (self.numbers(f"{name}.{part}", kinds="iu").astype(np.int64) for part in ("sec", "nanosec"))
        return np.asarray(sec * NS_PER_S + nanosec, np.int64)

    def _column(self, name: str) -> Column:
        if name not in self.columns:
            raise MessageLayoutError(self.type_name, f"its definition has no {name}")
        return self.columns[name]


def joined_column(parts: Sequence[Column]) -> Column:
    """Return parts of the same kind as one column; there is at least one."""
    if len(parts) == 1:
        return parts[0]
    arrays = [part for part in parts if isinstance(part, np.ndarray)]
    if arrays:
        return np.concatenate(arrays)
    ragged = [part for part in parts if isinstance(part, Ragged)]
    if ragged:
        begins = np.cumsum([0, *(part.offsets[-1] for part in ragged)])
        offsets = [part.offsets[1:] + begin for part, begin in zip(ragged, begins[:-1], strict=True)]
        return Ragged(np.concatenate([[0], *offsets]).astype(np.int64), joined_column([part.values for part in ragged]))
    return [text for part in parts if isinstance(part, list) for text in part]


# The limit of parts of all layouts, about 300 bytes each; a topic of one publisher has a few layouts of a hundred
# parts.
MOST_PIECES = 200_000

Values = NDArray[Any] | list[str]

STAMP = ("header.stamp.sec", "header.stamp.nanosec")


def decode_table(
    type_name: str,
    messages: Iterable[StampedMessage],
    known: Registry | None = None,
    only: Sequence[str] | None = None,
) -> MessageTable:
    """Decode every column of every message, or those in `only` (a path, or the start of one before a dot).

    Raises: DefinitionMissingError, DefinitionRefusedError, MessageLayoutError, ByteOrderError.
    """
    plan = (known or registry()).plan(type_name)
    parts = [_decoded(batch, plan, type_name, only) for batch in payload_batches(messages)]
    parts = parts or [_decoded([], plan, type_name, only)]
    columns = {name: joined_column([part.columns[name] for part in parts]) for name in parts[0].columns}
    return MessageTable(type_name, sum(part.count for part in parts), columns)


def _decoded(
    payloads: list[memoryview], plan: Sequence[Node], type_name: str, only: Sequence[str] | None
) -> MessageTable:
    columns: dict[str, Column] = {}
    _Filler(_stacked(payloads, plan, type_name), len(payloads), type_name).fill(plan, only, columns)
    return MessageTable(type_name, len(payloads), columns)


def _stacked(payloads: Sequence[memoryview], plan: Sequence[Node], type_name: str) -> list[Sheet[Sketch]]:
    """Return all sheets; refuse messages that differ so much that their layouts outgrow them."""

    def measure(payload: memoryview) -> tuple[Sketch, list[int]]:
        sketch = sketched(payload, plan, type_name)
        return sketch, sketch.lengths

    stacked: list[Sheet[Sketch]] = []
    pieces = 0
    for sheet in sheets(payloads, measure):
        stacked.append(sheet)
        pieces += len(sheet.layout.pieces)
        if pieces > MOST_PIECES:
            problem = f"{len(stacked)} messages of different layouts have more than {MOST_PIECES} parts together"
            raise MessageLayoutError(type_name, problem)
    return stacked


@dataclass(frozen=True, eq=False)
class _RepeatLevel:
    """A repetition around the current node: the start of the elements of each element above."""

    repeat: Repeat
    offsets: NDArray[np.int64]


class _Filler:
    """Puts the pieces of all sheets into columns, one column after the other."""

    def __init__(self, stacked: Sequence[Sheet[Sketch]], count: int, type_name: str) -> None:
        self._stacked, self._count, self._type_name = stacked, count, type_name
        self._pieces: dict[str, list[tuple[Sheet[Sketch], PayloadPiece]]] = {}
        for sheet in stacked:
            for piece in sheet.layout.pieces:
                self._pieces.setdefault(piece.node.name, []).append((sheet, piece))

    def fill(self, nodes: Sequence[Node], only: Sequence[str] | None, columns: dict[str, Column]) -> None:
        self._fill(nodes, (), only, columns)

    def _fill(
        self,
        nodes: Sequence[Node],
        levels: tuple[_RepeatLevel, ...],
        only: Sequence[str] | None,
        columns: dict[str, Column],
    ) -> None:
        for node in nodes:
            if isinstance(node, Repeat):
                if _is_wanted(node.name, only) or _leads_to(node.name, only):
                    inner = None if _is_wanted(node.name, only) else only
                    self._fill(node.element, (*levels, self._level(node, levels)), inner, columns)
            elif _is_wanted(node.name, only):
                columns[node.name] = _wrapped(self._values(node, levels), levels)

    def _level(self, repeat: Repeat, levels: tuple[_RepeatLevel, ...]) -> _RepeatLevel:
        counts = np.zeros(self._total(levels), np.int64)
        for sheet in self._stacked:
            for above, count in sheet.layout.counts.get(repeat.name, ()):
                counts[_places(sheet.rows, above, levels)] = count
        return _RepeatLevel(repeat, np.concatenate([[0], np.cumsum(counts)]).astype(np.int64))

    def _total(self, levels: tuple[_RepeatLevel, ...]) -> int:
        return int(levels[-1].offsets[-1]) if levels else self._count

    def _values(self, node: Leaf | TextNode, levels: tuple[_RepeatLevel, ...]) -> Values:
        total, pieces = self._total(levels), self._pieces.get(node.name, [])
        if isinstance(node, TextNode):
            texts = np.full(total, "", object)
            for sheet, piece in pieces:
                texts[_places(sheet.rows, piece.above, levels)] = self._texts(sheet, piece)
            return list(texts)
        shape = (total,) if node.length is None else (total, node.length)
        values = np.empty(shape, node.code.newbyteorder("="))
        for sheet, piece in pieces:
            values[_run_places(sheet.rows, piece, levels)] = _view(sheet.raw, piece, node)
        return values != 0 if node.is_bool else values

    def _texts(self, sheet: Sheet[Sketch], piece: PayloadPiece) -> NDArray[np.object_]:
        """Return the texts, decoded once per distinct value."""
        raw = [bytes(row) for row in sheet.raw[:, piece.offset : piece.offset + piece.text_bytes]]
        known = {text: text_of(text, self._type_name) for text in set(raw)}
        texts = np.empty(len(raw), object)
        texts[:] = [known[text] for text in raw]
        return texts


def _places(rows: NDArray[np.int64], above: tuple[int, ...], levels: tuple[_RepeatLevel, ...]) -> NDArray[np.int64]:
    """Return the rows of the table for the elements `above` of the messages `rows`."""
    for index, level in zip(above, levels, strict=False):
        rows = level.offsets[rows] + index
    return rows


def _run_places(rows: NDArray[np.int64], piece: PayloadPiece, levels: tuple[_RepeatLevel, ...]) -> NDArray[np.int64]:
    places = _places(rows, piece.above, levels)
    if piece.run is None:
        return places
    elements = piece.run.first + piece.run.step * np.arange(piece.run.elements)
    return np.asarray(levels[-1].offsets[places][:, None] + elements, np.int64)


def _view(raw: NDArray[np.uint8], piece: PayloadPiece, leaf: Leaf) -> NDArray[Any]:
    """Return (n,), (n, run), (n, length) or (n, run, length): a view of the numbers, aligned or not."""
    shape, strides = [len(raw)], [raw.shape[1]]
    if piece.run is not None:
        shape, strides = [*shape, piece.run.elements], [*strides, piece.run.stride]
    if leaf.length is not None:
        shape, strides = [*shape, leaf.length], [*strides, leaf.code.itemsize]
    return np.ndarray(shape, leaf.code, raw.data, piece.offset, strides)


def _wrapped(values: Values, levels: tuple[_RepeatLevel, ...]) -> Column:
    column: Column = values
    for level in reversed(levels):
        length = level.repeat.length
        if length is not None and isinstance(column, np.ndarray):
            column = column.reshape(len(level.offsets) - 1, length, *column.shape[1:])
        else:
            column = Ragged(level.offsets, column)
    return column


def _is_wanted(name: str, only: Sequence[str] | None) -> bool:
    return only is None or any(name == path or name.startswith(f"{path}.") for path in only)


def _leads_to(name: str, only: Sequence[str] | None) -> bool:
    return only is not None and any(path.startswith(f"{name}.") for path in only)
