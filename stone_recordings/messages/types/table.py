"""Messages of any type → columns, compiled from the definition of the type.

**Conventions.** Columns are those of `stone_recordings.messages.types.columns`, the wire format that of
`stone_recordings.messages.types.cdr`.
Messages of one layout are copied together; layouts are few, so what costs is the copying.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.errors import MessageLayoutError
from stone_recordings.messages.batch import StampedMessage, payload_batches
from stone_recordings.messages.types.cdr import Sheet, sheets, text_of
from stone_recordings.messages.types.columns import Column, MessageTable, Ragged, joined_column
from stone_recordings.messages.types.plan import Leaf, Node, Repeat, TextNode
from stone_recordings.messages.types.registry import Registry, registry
from stone_recordings.messages.types.sketch import PayloadPiece, Sketch, sketched

# Parts of all layouts together, some 300 bytes each; a topic of one publisher has a few layouts of a hundred parts.
MOST_PIECES = 200_000

Values = NDArray[Any] | list[str]

STAMP = ("header.stamp.sec", "header.stamp.nanosec")


def decode_table(
    type_name: str,
    messages: Iterable[StampedMessage],
    known: Registry | None = None,
    only: Sequence[str] | None = None,
) -> MessageTable:
    """Every column of every message, or those in `only` (a path, or what begins with it and a dot).

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
    """All sheets; refuses messages that are so unlike each other that their layouts outgrow them."""

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
    """A repetition around the node at hand: where the elements of each element above begin."""

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
        """Decoded once per distinct value."""
        raw = [bytes(row) for row in sheet.raw[:, piece.offset : piece.offset + piece.text_bytes]]
        known = {text: text_of(text, self._type_name) for text in set(raw)}
        texts = np.empty(len(raw), object)
        texts[:] = [known[text] for text in raw]
        return texts


def _places(rows: NDArray[np.int64], above: tuple[int, ...], levels: tuple[_RepeatLevel, ...]) -> NDArray[np.int64]:
    """Rows of the table that elements `above` of the messages `rows` have."""
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
    """(n,), (n, run), (n, length) or (n, run, length): the numbers where they lie, aligned or not."""
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
