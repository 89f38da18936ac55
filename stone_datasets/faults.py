"""Faults of a dataset: what is wrong, and in which table, row and file; and the collection of all that were found.

**Conventions.** Rows count from 1, as they stand in their table. The leaves are in `layout_faults.py`,
`table_faults.py` and `file_faults.py`; those of the layout itself, which the client knows too, in
`stone_files/dataset_layout.py`.
"""

from dataclasses import dataclass, field

from stone_files.dataset_faults import DatasetFaultError, DatasetPlace
from stone_files.dataset_layout import quoted

__all__ = ["MOST_SHOWN", "DatasetFaultError", "DatasetFaults", "DatasetPlace", "quoted"]
MOST_SHOWN = 100


@dataclass
class DatasetFaults:
    """Every fault is counted, the first `most` are kept; rows with one likely mistake are one fault of their file."""

    most: int = MOST_SHOWN
    found: list[DatasetFaultError] = field(default_factory=list)
    total: int = 0
    _alike: dict[tuple[str, str, str], DatasetFaultError] = field(default_factory=dict)

    def add(self, fault: DatasetFaultError) -> None:
        self.total += 1
        kind = (fault.code, fault.place.file, fault.likely)
        if fault.likely and kind in self._alike:
            self._alike[kind].rows += 1
        elif len(self.found) < self.most:
            self.found.append(fault)
            if fault.likely:
                self._alike[kind] = fault

    @property
    def left_out(self) -> int:
        """How many are counted and neither kept nor one of the rows of one that is."""
        return self.total - sum(fault.rows for fault in self.found)

    def __len__(self) -> int:
        return self.total

    def raise_first(self) -> None:
        """Raises the first fault, where there is one."""
        if self.found:
            raise self.found[0]
