"""The collection of a dataset's faults.

**Conventions.** Rows are numbered from 1 within their table. `stone_files/dataset_faults.py` lists the faults;
`stone_files/dataset_layout.py` has the layout faults that the client also detects.
"""

from dataclasses import dataclass, field

from stone_files.dataset_faults import DatasetFaultError, DatasetPlace
from stone_files.dataset_layout import quoted

__all__ = ["MOST_SHOWN", "DatasetFaultError", "DatasetFaults", "DatasetPlace", "quoted"]
MOST_SHOWN = 100


@dataclass
class DatasetFaults:
    """Counts every fault and keeps the first `most`; rows of a file with the same likely mistake are one fault."""

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
        """The number of faults that are neither kept nor merged into a kept fault."""
        return self.total - sum(fault.rows for fault in self.found)

    def __len__(self) -> int:
        return self.total

    def raise_first(self) -> None:
        """Raise the first fault, if there is one."""
        if self.found:
            raise self.found[0]
