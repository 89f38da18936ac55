"""The byte layout of one payload: the offset of each field, with every length checked.

**Conventions.** Offsets are bytes from the start of the payload, encapsulation included. Elements of numbers lie in
strides. CDR aligns from the body's start, so the first elements of a sequence can have another layout than the rest:
such a sequence becomes several runs. Elements with text or sequences are walked one by one.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from stone_recordings.bags.errors import MessageLayoutError
from stone_recordings.messages.types.cdr import HEAD_BYTES, Cursor
from stone_recordings.messages.types.plan import Leaf, Node, Repeat, TextNode

# Elements with text or sequences are walked one by one: more than any real message has are refused.
MOST_WALKED = 100_000


class ElementRun(NamedTuple):
    """Elements first, first + step, … (`elements` of them) of one repetition, `stride` bytes apart."""

    first: int
    step: int
    elements: int
    stride: int


class PayloadPiece(NamedTuple):
    """One leaf or text (`text_bytes` of it): the elements that enclose it (outermost first), then a run of them.

    `run` is None if `above` already contains the last enclosing repetition.
    """

    node: Leaf | TextNode
    above: tuple[int, ...]
    offset: int
    run: ElementRun | None = None
    text_bytes: int = 0


@dataclass
class Sketch:
    """The layout of a payload: `counts` holds, for every repetition of unknown length, its number of elements in each
    enclosing element. `lengths` are the offsets of all words that this layout depends on.
    """

    pieces: list[PayloadPiece] = field(default_factory=list)
    counts: dict[str, list[tuple[tuple[int, ...], int]]] = field(default_factory=dict)
    lengths: list[int] = field(default_factory=list)


def sketched(payload: memoryview, plan: Sequence[Node], type_name: str) -> Sketch:
    """Return the layout. Raises: MessageLayoutError (fields end beyond or well before the payload's end),
    ByteOrderError.
    """
    cursor = Cursor(payload, type_name)
    pen = _Pen(cursor)
    pen.draw(plan, ())
    cursor.end()
    return pen.sketch


class _Pen:
    def __init__(self, cursor: Cursor) -> None:
        self.cursor, self.sketch, self._walked = cursor, Sketch(), 0

    def draw(self, nodes: Sequence[Node], above: tuple[int, ...]) -> None:
        for node in nodes:
            if isinstance(node, Leaf):
                at = self.cursor.take(node.size_bytes, node.code.itemsize)
                self.sketch.pieces.append(PayloadPiece(node, above, at))
            elif isinstance(node, TextNode):
                offset, size = self.cursor.length()
                self.sketch.lengths.append(offset)
                self.sketch.pieces.append(PayloadPiece(node, above, self.cursor.take(size), None, size))
            else:
                self._repeat(node, above)

    def _repeat(self, node: Repeat, above: tuple[int, ...]) -> None:
        count = node.length
        if count is None:
            offset, count = self.cursor.length()
            self.sketch.lengths.append(offset)
        self.cursor.bounded(count, node.least_bytes)
        self.sketch.counts.setdefault(node.name, []).append((above, count))
        if node.is_flat:
            self._flat(node, above, count)
            return
        self._walked += count
        if self._walked > MOST_WALKED:
            problem = f"{node.name} has {count} elements of varying size, {MOST_WALKED} are read"
            raise MessageLayoutError(self.cursor.type_name, problem)
        for index in range(count):
            self.draw(node.element, (*above, index))

    def _flat(self, node: Repeat, above: tuple[int, ...], count: int) -> None:
        for run, offsets in self._runs(node, count):
            for leaf, offset in zip(node.leaves, offsets, strict=True):
                self.sketch.pieces.append(PayloadPiece(leaf, above, offset, run))

    def _runs(self, node: Repeat, count: int) -> Iterator[tuple[ElementRun, list[int]]]:
        """Yield elements one by one until one starts like an earlier one; from there on they repeat."""
        seen: dict[int, int] = {}
        begun: list[list[int]] = []
        for index in range(count):
            offsets = [self.cursor.take(leaf.size_bytes, leaf.code.itemsize) for leaf in node.leaves]
            phase = (offsets[0] - HEAD_BYTES) % node.alignment
            if phase in seen:
                yield from self._cycle(node, begun, (seen[phase], index, offsets[0]), count)
                return
            seen[phase] = index
            begun.append(offsets)
        yield from ((ElementRun(at, 1, 1, 0), offsets) for at, offsets in enumerate(begun))

    def _cycle(
        self, node: Repeat, begun: list[list[int]], again: tuple[int, int, int], count: int
    ) -> Iterator[tuple[ElementRun, list[int]]]:
        """Yield the elements before the cycle one by one, then one run for each element of the cycle.

        `again` is the cycle's first element, the element at which it repeats, and the offset of the latter.
        """
        first, index, offset = again
        step, stride = index - first, offset - begun[first][0]
        last = node.leaves[-1].size_bytes
        end = self.cursor.at
        yield from ((ElementRun(at, 1, 1, 0), offsets) for at, offsets in enumerate(begun[:first]))
        for at, offsets in enumerate(begun[first:], first):
            elements = (count - at + step - 1) // step
            yield ElementRun(at, step, elements, stride), offsets
            end = max(end, offsets[-1] + last + (elements - 1) * stride)
        self.cursor.take(end - self.cursor.at)
