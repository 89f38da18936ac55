"""Rows of a rosbag2 database: by SQLite from sound files, by salvage from damaged ones.

**Conventions.** Rows are named by rowid, which grows as messages are written. A row with other column types than a
recorder's, or with more bytes than the file, is not listed but counted.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding


@dataclass(frozen=True)
class Db3Topic:
    topic_id: int
    name: str
    type: str
    encoding: str


@dataclass(frozen=True, eq=False)
class RowIndex:
    """One entry per message, rowids ascending; `left_out` counts the rows that are no messages."""

    rowid: NDArray[np.int64]
    topic_id: NDArray[np.int64]
    time_ns: NDArray[np.int64]
    size_bytes: NDArray[np.int64]
    left_out: int


class Db3Rows(Protocol):
    topics: tuple[Db3Topic, ...]
    definitions: dict[str, str]
    index: RowIndex
    findings: tuple[Finding, ...]

    def data(self, rowid: int) -> bytes:
        """Return the whole message."""
        ...

    def several(self, rowids: Sequence[int]) -> dict[int, bytes]:
        """Return whole messages by rowid, for small ones that are read one after the other."""
        ...

    def head(self, rowid: int, size_bytes: int) -> bytes:
        """Return the first bytes of the message, without reading the others."""
        ...

    def release(self) -> None: ...

    def close(self) -> None: ...
