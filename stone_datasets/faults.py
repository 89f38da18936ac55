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
