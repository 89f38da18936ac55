"""Compiled message definitions: nested types as dotted names, arrays as nodes.

**Conventions.** A plan contains everything about a type that does not depend on a payload. Definitions may be hostile:
cycles, depth, the number of nodes and the bytes of fixed arrays are bounded here, once per type.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stone_recordings.messages.errors import DefinitionRefusedError
from stone_recordings.messages.types.definition import CODES, Field, Types

MOST_DEPTH = 24
MOST_NODES = 10_000
MOST_FIXED_BYTES = 1 << 26


@dataclass(frozen=True)
class Leaf:
    """A number, or `length` of them in a row (None: a single one)."""

    name: str
    code: np.dtype[np.generic]
    length: int | None = None
    is_bool: bool = False

    @property
    def size_bytes(self) -> int:
        return int(self.code.itemsize) * (1 if self.length is None else self.length)


@dataclass(frozen=True)
class TextNode:
    name: str


@dataclass(frozen=True)
class Repeat:
    """`length` elements, or the number in the payload (None)."""

    name: str
    length: int | None
    element: tuple["Node", ...]

    @cached_property
    def is_flat(self) -> bool:
        """Whether an element is numbers only, so that elements lie in strides."""
        return all(isinstance(node, Leaf) for node in self.element)

    @cached_property
    def leaves(self) -> tuple[Leaf, ...]:
        return tuple(node for node in self.element if isinstance(node, Leaf))

    @cached_property
    def least_bytes(self) -> int:
        """The least bytes of one element."""
        return max(1, sum(_least_bytes(node) for node in self.element))

    @cached_property
    def alignment(self) -> int:
        """The strictest alignment of an element's numbers."""
        return max((int(leaf.code.itemsize) for leaf in self.leaves), default=1)


Node = Leaf | TextNode | Repeat


def compiled(type_name: str, types: Types) -> tuple[Node, ...]:
    """Compile a type. Raises: DefinitionRefusedError (a type that is missing, contains itself, or exceeds any real
    message).
    """
    plan = tuple(_Compiler(type_name, types).nodes(type_name, "", ()))
    fixed_bytes = sum(_least_bytes(node) for node in plan)
    if fixed_bytes > MOST_FIXED_BYTES:
        raise DefinitionRefusedError(type_name, f"it takes at least {fixed_bytes} bytes, {MOST_FIXED_BYTES} are read")
    return plan


def _least_bytes(node: Node) -> int:
    if isinstance(node, Leaf):
        return node.size_bytes
    if isinstance(node, TextNode) or node.length is None:
        return 4
    return node.length * node.least_bytes


class _Compiler:
    """Counts the nodes of one type, so that types which multiply each other are refused early."""

    def __init__(self, type_name: str, types: Types) -> None:
        self._type_name, self._types, self._count = type_name, types, 0

    def nodes(self, type_name: str, prefix: str, above: tuple[str, ...]) -> Iterator[Node]:
        if type_name not in self._types:
            raise DefinitionRefusedError(self._type_name, f"{type_name} is used and not defined")
        if type_name in above or len(above) > MOST_DEPTH:
            problem = "contains itself" if type_name in above else f"is nested deeper than {MOST_DEPTH}"
            raise DefinitionRefusedError(self._type_name, f"{type_name} {problem}")
        for field in self._types[type_name]:
            yield from self._of_field(field, prefix + field.name, (*above, type_name))

    def _of_field(self, field: Field, name: str, above: tuple[str, ...]) -> Iterator[Node]:
        self._count += 1
        if self._count > MOST_NODES:
            raise DefinitionRefusedError(self._type_name, f"it has more than {MOST_NODES} values")
        if field.kind == "array" and field.base in CODES:
            yield _leaf(field, name, field.length)
        elif field.kind == "one":
            yield from self._single(field, name, above)
        else:
            element = tuple(self._single(field, name, above))
            yield Repeat(name, field.length if field.kind == "array" else None, element)

    def _single(self, field: Field, name: str, above: tuple[str, ...]) -> Iterator[Node]:
        if field.base in CODES:
            yield _leaf(field, name, None)
        elif field.base == "string":
            yield TextNode(name)
        elif field.base == "wstring":
            raise DefinitionRefusedError(self._type_name, f"{name} is a wstring, which has no agreed form on the wire")
        else:
            yield from self.nodes(field.base, f"{name}.", above)


def _leaf(field: Field, name: str, length: int | None) -> Leaf:
    return Leaf(name, np.dtype(CODES[field.base]), length, field.base == "bool")
