"""Decoded messages as columns, asked for by name and kind.

**Conventions.** A column is named by its dotted path ("header.stamp.sec"). Numbers outside of sequences are arrays
(N,) or, for fixed arrays, (N, length); texts are lists of N; what lies in a sequence is `Ragged`, once for every
sequence around it. Rows are in the order of the messages.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.errors import MessageLayoutError
from stone_recordings.messages.types.cdr import NS_PER_S


def as_doubles(values: NDArray[Any]) -> NDArray[np.float64]:
    """A damaged message may hold a signalling NaN, which is as good as any other."""
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
    """N messages; `columns` has the leaves that were asked for, by dotted path.

    A recording's own definition may lack a field or make another thing of it, so whoever wants a column says of what
    kind: every accessor raises MessageLayoutError where it is none of that kind.
    """

    type_name: str
    count: int
    columns: Mapping[str, Column]

    def numbers(self, name: str, length: int | None = None, kinds: str = "fiu") -> NDArray[Any]:
        """(N,), or (N, length) of a fixed array; `kinds` are numpy's, "iu" for whole numbers only."""
        column = self._column(name)
        shape = () if length is None else (length,)
        if not isinstance(column, np.ndarray) or column.shape[1:] != shape or column.dtype.kind not in kinds:
            one, many = ("a number", "numbers") if "f" in kinds else ("an integer", "integers")
            kind = one if length is None else f"an array of {length} {many}"
            raise MessageLayoutError(self.type_name, f"its definition does not declare {name} as {kind}")
        return column

    def vectors(self, name: str, axes: str = "xyz") -> NDArray[np.float64]:
        """(N, len(axes)) from the columns name.x, name.y, …"""
        columns = [self.numbers(f"{name}.{axis}") for axis in axes]
        return as_doubles(np.stack(columns, axis=1))

    def texts(self, name: str) -> list[str]:
        """One text a message."""
        column = self._column(name)
        if not isinstance(column, list):
            raise MessageLayoutError(self.type_name, f"its definition does not declare {name} as a string")
        return column

    def ragged(self, name: str) -> tuple[NDArray[np.int64], NDArray[Any]]:
        """Offsets (N + 1,) and numbers (M,) of a sequence."""
        column = self._column(name)
        if isinstance(column, Ragged) and isinstance(column.values, np.ndarray) and column.values.ndim == 1:
            return column.offsets, column.values
        raise MessageLayoutError(self.type_name, f"its definition does not declare {name} as a sequence of numbers")

    def ragged_texts(self, name: str) -> tuple[NDArray[np.int64], list[str]]:
        """Offsets (N + 1,) and texts (M) of a sequence."""
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
    """One column of parts of the same kind, one after the other; there is at least one."""
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
