"""Faults of a dataset: what is wrong, and in which table, row and file; and the collection of all that were found.

**Conventions.** Rows count from 1, as they stand in their table. The leaves are in `layout_faults.py`,
`table_faults.py` and `file_faults.py`.
"""

from dataclasses import asdict, dataclass, field
from reprlib import Repr
from typing import ClassVar

from stone.errors import StoneError

MOST_SHOWN = 100
QUOTED = 120
SHORT = Repr()
SHORT.maxlevel, SHORT.maxlist, SHORT.maxdict, SHORT.maxstring = 4, 8, 4, QUOTED


@dataclass(frozen=True)
class DatasetPlace:
    """Where a fault is: a file of the dataset, by its name there, and the row where it is a table's."""

    file: str
    row: int | None = None
    token: str = ""

    def __str__(self) -> str:
        row = "" if self.row is None else f" row {self.row}"
        token = f" (token {self.token[:QUOTED]})" if self.token else ""
        return f"{self.file[: 2 * QUOTED]}{row}{token}"


class DatasetFaultError(StoneError):
    """Something in a published dataset is wrong. `likely` is the mistake that usually is behind it."""

    likely: ClassVar[str]

    def __init__(self, place: DatasetPlace, what: str) -> None:
        super().__init__(f"{place}: {what} ({self.likely})")
        self.place = place

    def as_record(self) -> dict[str, object]:
        return {"code": self.code, **asdict(self.place), "message": str(self)}


@dataclass
class DatasetFaults:
    """Every fault is counted, the first `most` are kept."""

    most: int = MOST_SHOWN
    found: list[DatasetFaultError] = field(default_factory=list)
    total: int = 0

    def add(self, fault: DatasetFaultError) -> None:
        if len(self.found) < self.most:
            self.found.append(fault)
        self.total += 1

    def __len__(self) -> int:
        return self.total

    def raise_first(self) -> None:
        """Raises the first fault, where there is one."""
        if self.found:
            raise self.found[0]


def quoted(value: object) -> str:
    """A value from outside as a message shows it: short, and no deeper than anybody would read."""
    text = SHORT.repr(value)
    return text if len(text) <= QUOTED else f"{text[:QUOTED]}…"
