"""The metric as one would write it down from its definition: column by column, in plain integers and fractions.

**Conventions.** Nothing of the platform is imported: this is what its kernels are held against, and what the golden
vectors are made by. Grids are uint8 or bool, axes x, y, z; a place is where one lies and how large its voxels are:
lowest x and y and side, in mm. A frame's counts are plain lists: `confusion`
[ring][truth][prediction], `bev` [ring][both, truth only, prediction only], `pairs` [ring][occupied, T, P, N],
`columns` [ring][truth][prediction].
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any

Ratio = float | None
Place = tuple[int, int, int]
PAPER: Place = (-25_600, -25_600, 200)


@dataclass(frozen=True)
class Counts:
    confusion: list[list[list[int]]]
    bev: list[list[int]]
    pairs: list[list[int]]
    columns: list[list[list[int]]]


def ring_of(x: int, y: int, place: Place) -> int:
    """0 below 10 m, 1 below 20 m, 2 beyond: of the column's centre, in half millimetres."""
    low_x, low_y, side = place
    squared = (2 * low_x + (2 * x + 1) * side) ** 2 + (2 * low_y + (2 * y + 1) * side) ** 2
    return (squared >= 20_000**2) + (squared >= 40_000**2)


def is_drivable(labels: Sequence[int]) -> bool:
    return (1 in labels or 2 in labels) and 3 not in labels


def slow_counts(truth: Any, prediction: Any, is_evaluated: Any, place: Place = PAPER) -> Counts:
    """What is to be counted of one frame. Raises `ValueError` where the prediction holds what is no class."""
    if prediction.max() > 3:
        raise ValueError("label_out_of_range")
    confusion, columns = ([[[0] * 4 for _ in range(4)] for _ in range(3)] for _ in range(2))
    bev, near = [[0] * 3 for _ in range(3)], [[0] * 4 for _ in range(3)]
    grids = [grid.astype("uint8").tobytes() for grid in (truth, prediction, is_evaluated)]
    across, along, height = truth.shape
    for number in range(across * along):
        column_grids = [grid[height * number : height * number + height] for grid in grids]
        pairs, there, claimed = column_counts(*column_grids)
        ring = ring_of(*divmod(number, along), place)
        for (row, column), voxels in pairs.items():
            confusion[ring][row][column] += voxels
        bev[ring][0] += there and claimed
        bev[ring][1] += there and not claimed
        bev[ring][2] += claimed and not there
        found, row, column = column_scores(*column_grids, -(-1600 // place[2]))
        near[ring] = [old + new for old, new in zip(near[ring], found, strict=True)]
        columns[ring][row][column] += 1
    return Counts(confusion, bev, near, columns)


@lru_cache(maxsize=2**17)
def column_counts(true: bytes, predicted: bytes, seen: bytes) -> tuple[Counter[tuple[int, int]], bool, bool]:
    """Evaluated pairs (truth, prediction) of a column, and whether it is drivable in either; most columns are alike."""
    pairs = [(row, column) for row, column, counts in zip(true, predicted, seen, strict=True) if counts]
    return Counter(pairs), is_drivable([row for row, _ in pairs]), is_drivable([column for _, column in pairs])


@lru_cache(maxsize=2**17)
def column_scores(true: bytes, predicted: bytes, seen: bytes, free: int = 8) -> tuple[list[int], int, int]:
    """Pairs of occupied, T, P and N of a column, and its class in the truth and in the prediction; a robot drives under
    what has so many voxels `free` below it."""
    a, b = ([label if is_seen else 0 for label, is_seen in zip(grid, seen, strict=True)] for grid in (true, predicted))
    pairs = [pairs_of(a, b, labels) for labels in ((1, 2, 3), (1,), (2,), (3,))]
    return pairs, class_of(a, free), class_of(b, free)


def pairs_of(a: Sequence[int], b: Sequence[int], labels: Sequence[int]) -> int:
    """The voxels with one of the other side at most one voxel above or below: of the side that has fewer of them."""
    in_a, in_b = ([z for z in range(len(side)) if side[z] in labels] for side in (a, b))
    near_b = [z for z in in_a if any(abs(z - other) <= 1 for other in in_b)]
    near_a = [z for z in in_b if any(abs(z - other) <= 1 for other in in_a)]
    return min(len(near_b), len(near_a))


def class_of(labels: Sequence[int], free: int) -> int:
    """The worst of a column; an N does not count if 1.6 m or more, so many voxels, are free to drive under."""
    surface = [z for z in range(len(labels)) if labels[z] in (1, 2)]
    blocking = [z for z in range(len(labels)) if labels[z] == 3 and not (surface and z - surface[0] - 1 >= free)]
    if blocking:
        return 3
    return 2 if 2 in labels else 1 if 1 in labels else 0


def slow_tolerant(counts: Sequence[Counts]) -> dict[str, Ratio]:
    """The ratios over pairs, of all frames and rings."""
    cells, _ = added(counts)
    pairs = [sum(one.pairs[r][k] for one in counts for r in range(3)) for k in range(4)]
    parts = []
    for labels, both in zip(((1, 2, 3), (1,), (2,), (3,)), pairs, strict=True):
        in_truth = sum(cells[t][p] for t in labels for p in range(4))
        in_prediction = sum(cells[t][p] for t in range(4) for p in labels)
        parts.append(quotient(both, in_truth + in_prediction - both))
    known = [part for part in parts[1:] if part is not None]
    mean = sum(known) / 3 if len(known) == 3 else None
    named = zip(("iou_occ", "iou_t", "iou_p", "iou_n", "miou"), (*parts, mean), strict=True)
    return {name: None if value is None else float(value) for name, value in named}


def added_columns(counts: Sequence[Counts]) -> list[list[int]]:
    """The confusion of columns of all frames and rings."""
    return [[sum(one.columns[r][t][p] for one in counts for r in range(3)) for p in range(4)] for t in range(4)]


def added(counts: Sequence[Counts]) -> tuple[list[list[int]], list[int]]:
    """The confusion [truth][prediction] and the columns of all frames and rings."""
    cells = [[sum(one.confusion[r][t][p] for one in counts for r in range(3)) for p in range(4)] for t in range(4)]
    return cells, [sum(one.bev[r][k] for one in counts for r in range(3)) for k in range(3)]


def slow_ratios(cells: Sequence[Sequence[int]], metric: str) -> dict[str, Ratio]:
    """`metric` is stone-iou or stone-iou-occupied, of any version."""
    rows = {"stone-iou": (0, 1, 2, 3), "stone-iou-occupied": (1, 2, 3)}[metric.rpartition("-")[0]]
    occupied = [(t, p) for t in range(4) for p in range(4) if t and p]
    either = [(t, p) for t in range(4) for p in range(4) if t or p]
    iou_occ = quotient(sum(cells[t][p] for t, p in occupied), sum(cells[t][p] for t, p in either))
    parts = []
    for c in (1, 2, 3):
        union = sum(cells[t][p] for t in rows for p in range(4) if c in (t, p))
        parts.append(quotient(cells[c][c], union))
    known = [part for part in parts if part is not None]
    mean = sum(known) / 3 if len(known) == 3 else None
    named = zip(("iou_occ", "iou_t", "iou_p", "iou_n", "miou"), (iou_occ, *parts, mean), strict=True)
    return {name: None if value is None else float(value) for name, value in named}


def slow_extras(
    cells: Sequence[Sequence[int]], columns: Sequence[int], clear: Sequence[Sequence[int]]
) -> dict[str, Ratio]:
    drivable = [(t, p) for t in range(4) for p in range(4) if t in (1, 2) or p in (1, 2)]
    in_both = sum(clear[t][p] for t in (1, 2) for p in (1, 2))
    named = {
        "n_predicted_t_ratio": quotient(cells[3][1], sum(cells[3])),
        "n_predicted_drivable_ratio": quotient(cells[3][1] + cells[3][2], sum(cells[3])),
        "t_predicted_n_ratio": quotient(cells[1][3], sum(cells[1])),
        "bev_drivable_iou": quotient(columns[0], sum(columns)),
        "clear_drivable_iou": quotient(in_both, sum(clear[t][p] for t, p in drivable)),
    }
    return {name: None if value is None else float(value) for name, value in named.items()}


def quotient(part: int, whole: int) -> Fraction | None:
    return Fraction(part, whole) if whole else None
