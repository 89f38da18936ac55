"""Consistency of tables: references, chains of prev and next, stamps, and unique files.

**Conventions.** All functions add the faults that they find. They compare whole columns, so their duration does not
depend on the content. `group` identifies the rows of one chain.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone_datasets.columns import NONE, Keys, repeated, rows_of
from stone_datasets.faults import DatasetFaultError, DatasetFaults, DatasetPlace
from stone_datasets.tables import DatasetTables, SceneRow

Places = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class LinkedRows:
    """Columns of a table whose rows form chains; `tokens` if they are kept."""

    file: str
    keys: Keys
    previous: Keys
    next: Keys
    stamps: NDArray[np.int64]
    group: Places
    tokens: Sequence[str] = ()

    def place(self, row: int) -> DatasetPlace:
        return DatasetPlace(self.file, row + 1, self.tokens[row] if self.tokens else "")


def check_chains(rows: LinkedRows, faults: DatasetFaults) -> None:
    """Check that every group is one chain through all of its rows, in stamp order; report only the first kind of
    fault.
    """
    before = faults.total
    following, preceding = (_linked(rows, what, keys, faults) for what, keys in _links(rows))
    if faults.total > before:
        return
    for faults_of_kind in (
        _one_sided(rows, following, preceding),
        _cyclic(rows),
        _not_rising(rows, following),
        _broken(rows),
    ):
        for fault in faults_of_kind:
            faults.add(fault)
        if faults.total > before:
            return


def check_scenes(tables: DatasetTables, samples: LinkedRows, faults: DatasetFaults) -> None:
    """Check that names are unique, and that first, last and number match the samples; their chains must be valid."""
    scenes = list(tables.scenes.values())
    for again, first in repeated([hash(scene.name) for scene in scenes]):
        faults.add(
            DatasetFaultError("DST-031", scenes[again].row.place, f"row {first + 1} is also named {scenes[again].name}")
        )
    counts = np.bincount(samples.group, minlength=len(scenes))
    order = np.lexsort((samples.stamps, samples.group))
    ends = np.cumsum(counts)
    for scene, count, end in zip(scenes, counts.tolist(), ends.tolist(), strict=True):
        if scene.samples != count or not count:
            what = f"nbr_samples is {scene.samples}, but it has {count} samples"
            faults.add(DatasetFaultError("DST-033", scene.row.place, what))
        if count:
            _check_ends(scene, samples, (int(order[end - count]), int(order[end - 1])), faults)


def _check_ends(scene: SceneRow, samples: LinkedRows, ends: tuple[int, int], faults: DatasetFaults) -> None:
    for key, token, row in zip(("first", "last"), (scene.first, scene.last), ends, strict=True):
        if token != samples.tokens[row]:
            what = f"{key}_sample_token is {token!r}, but its {key} sample along prev and next is {samples.tokens[row]}"
            faults.add(DatasetFaultError("DST-032", scene.row.place, what))


def _links(rows: LinkedRows) -> tuple[tuple[str, Keys], tuple[str, Keys]]:
    return ("next", rows.next), ("prev", rows.previous)


def _linked(rows: LinkedRows, what: str, keys: Keys, faults: DatasetFaults) -> Places:
    """Return the row that each key refers to, or −1 at an end."""
    targets = rows_of(rows.keys, keys)
    for row in np.flatnonzero((targets < 0) & (keys != NONE)).tolist():
        faults.add(DatasetFaultError("DST-030", rows.place(row), f"{what} is not a token of its own table"))
    return np.where(keys == NONE, -1, targets)


def _one_sided(rows: LinkedRows, following: Places, preceding: Places) -> Iterator[DatasetFaultError]:
    """Yield rows whose next does not link back, or is in another chain, and the same for prev."""
    here = np.arange(len(following))
    for what, there, back in (("next", following, preceding), ("prev", preceding, following)):
        is_linked = there >= 0
        is_returned = back[there] == here
        is_kin = rows.group[there] == rows.group
        for row in np.flatnonzero(is_linked & ~(is_returned & is_kin)).tolist():
            other = "belongs to another scene or sensor" if is_returned[row] else "does not link back to this row"
            yield DatasetFaultError("DST-034", rows.place(row), f"its {what}, row {there[row] + 1}, {other}")


def _cyclic(rows: LinkedRows) -> Iterator[DatasetFaultError]:
    """Yield groups in which every row has a prev."""
    groups, firsts = np.unique(rows.group, return_index=True)
    is_begun = np.isin(groups, rows.group[rows.previous == NONE])
    for row in firsts[~is_begun].tolist():
        yield DatasetFaultError(
            "DST-034", rows.place(row), "every row of its scene and sensor has a prev, so the chain is a cycle"
        )


def _not_rising(rows: LinkedRows, following: Places) -> Iterator[DatasetFaultError]:
    is_wrong = (following >= 0) & (rows.stamps[following] <= rows.stamps)
    for row in np.flatnonzero(is_wrong).tolist():
        after = following[row]
        what = f"its timestamp is {rows.stamps[row]}, but its next, row {after + 1}, has {rows.stamps[after]}"
        yield DatasetFaultError("DST-035", rows.place(row), what)


def _broken(rows: LinkedRows) -> Iterator[DatasetFaultError]:
    """Yield further starts of a group's chain: links are mutual and increase, so one start means one complete chain."""
    begins = np.flatnonzero(rows.previous == NONE)
    for again, first in repeated(rows.group[begins]):
        row, other = int(begins[again]), int(begins[first])
        yield DatasetFaultError(
            "DST-034", rows.place(row), f"it has no prev, like row {other + 1} of the same scene and sensor"
        )
