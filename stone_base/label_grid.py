"""The label grids around the robot, as immutable values, and the named grids of the platform.

**Conventions.** A grid is aligned with the ego frame. `min_m` is its lowest corner; voxel [i, j, k] starts at `min_m` +
[i, j, k] · `voxel_m`. Arrays have its `shape`, axes x, y, z, C order. Labels come from a map with voxels of
`MAP_VOXEL_M`; a grid voxel is a cube of `pooled`³ map voxels. Two grids are comparable if their `geometry` is equal.

Sources: the paper (256 × 256 × 32 voxels of 0.2 m); the README of the released dataset, revision 4ba5f700; Occ3D (arXiv
2304.14365), which defined the release's grid.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import isfinite, prod

from stone_base.errors import Refused

MAP_VOXEL_M = 0.2
MOST_SIDE, MOST_MAP_SIDE, SIDE_STEP = 320, 512, 8
HEIGHTS = (8, 16, 32)
"""Allowed voxels per column: a map column is one 32-bit word, and whole columns fill such words."""
MOST_MAP_HEIGHT = 32
MOST_AWAY_M = 200.0
NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,39}")
Corner = tuple[float, float, float]
Shape = tuple[int, int, int]


@dataclass(frozen=True)
class LabelGrid:
    """A grid: its lowest corner `min_m`, the side `voxel_m` of a voxel and the number of voxels along each axis.

    `classes` are the numbers of free, T, P and N in its files. `unknown` is the value of unobserved voxels in its
    files, or None if the files' masks mark them.
    """

    name: str
    min_m: Corner
    voxel_m: float
    shape: Shape
    classes: tuple[int, int, int, int] = (0, 1, 2, 3)
    unknown: int | None = None

    @property
    def max_m(self) -> Corner:
        """The highest corner, rounded to a micrometre: 256 · 0.2 − 25.6 is 25.6."""
        x, y, z = (round(low + size * self.voxel_m, 6) for low, size in zip(self.min_m, self.shape, strict=True))
        return x, y, z

    @property
    def voxels(self) -> int:
        """The number of voxels."""
        return prod(self.shape)

    @property
    def pooled(self) -> int:
        """The number of map voxels along one side of a grid voxel."""
        return round(self.voxel_m / MAP_VOXEL_M)

    @property
    def on_map(self) -> "LabelGrid":
        """The same grid with voxels of the map's size."""
        x, y, z = (size * self.pooled for size in self.shape)
        return replace(self, voxel_m=MAP_VOXEL_M, shape=(x, y, z))

    @property
    def geometry(self) -> tuple[Corner, float, Shape]:
        """The values that determine the position of every voxel."""
        return self.min_m, self.voxel_m, self.shape

    def as_record(self) -> dict[str, object]:
        """Return the grid as JSON for `grid_of`."""
        record: dict[str, object] = {"name": self.name, "min_m": list(self.min_m), "voxel_m": self.voxel_m}
        return {**record, "shape": list(self.shape), "classes": list(self.classes), "unknown": self.unknown}

    def __str__(self) -> str:
        """Return the name and extent, for use in a sentence."""
        low, high = (" ".join(f"{value:g}" for value in corner) for corner in (self.min_m, self.max_m))
        return f"{self.name} ({' × '.join(map(str, self.shape))} of {self.voxel_m:g} m, [{low}] to [{high}] m)"


PAPER = LabelGrid("paper", (-25.6, -25.6, -2.0), 0.2, (256, 256, 32))
RELEASE = LabelGrid("release", (-40.0, -40.0, -1.0), 0.4, (200, 200, 16), unknown=255)
OCC3D = LabelGrid("occ3d", (-40.0, -40.0, -1.0), 0.4, (200, 200, 16))
GRIDS: Mapping[str, LabelGrid] = {grid.name: grid for grid in (PAPER, RELEASE, OCC3D)}


def named_grid(name: str) -> LabelGrid:
    """Return the grid of this name. Raises `bad_grid`."""
    if name not in GRIDS:
        raise Refused("bad_grid", f"unknown grid {name[:80]!r}; choose one of {', '.join(GRIDS)}")
    return GRIDS[name]


def require_one_geometry(a: LabelGrid, b: LabelGrid) -> None:
    """Raise `grids_differ` if the voxels of A and B have different positions."""
    if a.geometry != b.geometry:
        raise Refused(
            "grids_differ",
            f"A has the grid {a}, B has {b}; labels can only be compared on the same grid: process one of the "
            "two again",
        )


def recorded_grid(record: object) -> LabelGrid:
    """Return the recorded grid; a missing record means the paper's grid. Raises `bad_grid`."""
    return PAPER if record is None else grid_of(record)


def record_unless_paper(grid: LabelGrid) -> dict[str, object] | None:
    """Return the record for `recorded_grid`, or None for the paper's grid."""
    return None if grid == PAPER else grid.as_record()


def grid_of_shape(shape: tuple[int, ...]) -> LabelGrid | None:
    """Return the first known grid with this shape, or None."""
    return next((grid for grid in GRIDS.values() if grid.shape == shape), None)


def grid_with_shape(shape: tuple[int, ...]) -> LabelGrid:
    """Return a grid with this shape at any position. Raises `bad_grid` if no grid can have the shape."""
    return grid_of_shape(shape) or grid_of(
        {"name": "unnamed", "min_m": [0, 0, 0], "voxel_m": MAP_VOXEL_M, "shape": shape}
    )


def grid_of(record: object) -> LabelGrid:
    """Return the grid that a JSON object in the form of `LabelGrid.as_record` describes. Raises `bad_grid`."""
    if not isinstance(record, Mapping):
        raise _bad("an object", record)
    unknown_keys = sorted(set(record) - {"name", "min_m", "voxel_m", "shape", "classes", "unknown"})
    if unknown_keys:
        raise _bad("name, min_m, voxel_m, shape, classes and unknown, and no other key", unknown_keys[0])
    low, voxel_m, shape = record.get("min_m"), record.get("voxel_m"), record.get("shape")
    if not (isinstance(low, list | tuple) and len(low) == 3 and all(map(_is_near, low))):
        raise _bad(f"min_m as three numbers of metres within ± {MOST_AWAY_M:g}", low)
    if not (_is_number(voxel_m) and MAP_VOXEL_M <= voxel_m <= MOST_MAP_HEIGHT * MAP_VOXEL_M and _is_multiple(voxel_m)):  # type: ignore[operator, arg-type]
        raise _bad(f"voxel_m as an integer multiple of {MAP_VOXEL_M} m, the voxel size of the map", voxel_m)
    if not (isinstance(shape, list | tuple) and len(shape) == 3 and all(type(size) is int for size in shape)):
        raise _bad("shape as three integers (voxels)", shape)
    name, classes, unknown = record.get("name"), record.get("classes", PAPER.classes), record.get("unknown")
    if not (isinstance(name, str) and NAME.fullmatch(name)):
        raise _bad("name as 1 to 40 lower-case letters, digits, - or _", name)
    if not (isinstance(classes, list | tuple) and tuple(classes) == PAPER.classes):
        raise _bad("classes as [0, 1, 2, 3]", classes)
    if not (unknown is None or (type(unknown) is int and 4 <= unknown <= 255)):
        raise _bad("unknown as null or an integer from 4 to 255", unknown)
    corner = (float(low[0]), float(low[1]), float(low[2]))
    grid = LabelGrid(name, corner, float(voxel_m), (shape[0], shape[1], shape[2]), PAPER.classes, unknown)  # type: ignore[arg-type]
    _check(grid)
    return grid


def _check(grid: LabelGrid) -> None:
    x, y, z = grid.shape
    most = min(MOST_SIDE, MOST_MAP_SIDE // grid.pooled)
    if not all(SIDE_STEP <= side <= most and side % SIDE_STEP == 0 for side in (x, y)):
        raise _bad(f"multiples of {SIDE_STEP} from {SIDE_STEP} to {most} voxels along x and y", f"{x} × {y}")
    if z not in HEIGHTS or z * grid.pooled > MOST_MAP_HEIGHT:
        most_m = MOST_MAP_HEIGHT * MAP_VOXEL_M
        raise _bad(f"{', '.join(map(str, HEIGHTS))} voxels, at most {most_m:g} m in total, along z", z)
    known = GRIDS.get(grid.name)
    if known is not None and known != grid:
        raise _bad(f"the name {grid.name!r} only for {known}", grid)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)


def _is_near(value: object) -> bool:
    return _is_number(value) and abs(value) <= MOST_AWAY_M  # type: ignore[arg-type]


def _is_multiple(voxel_m: float) -> bool:
    return abs(voxel_m / MAP_VOXEL_M - round(voxel_m / MAP_VOXEL_M)) < 1e-9


def _bad(expected: str, value: object) -> Refused:
    return Refused("bad_grid", f"a grid must have {expected}; got {str(value)[:120]!r}")
