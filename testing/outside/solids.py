"""The solids of an analytic world, each in closed form: ellipsoids, upright cylinders, boxes, grass.

**Conventions.** A solid is a row of `SOLID`, with half sizes along its own axes, turned by `yaw_rad` about the
vertical. `free_path_m` is a ray's mean length within the solid before a hit; opaque solids have 0. Grass is an upright
cylinder whose blades end `half_m[2]` · 2 above the ground below them.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from testing.outside.ground import Array

Kind = Literal["trunk", "crown", "bush", "wall", "bar", "post", "rock", "small rock", "roof", "person", "grass"]
KINDS: tuple[Kind, ...] = (
    "trunk", "crown", "bush", "wall", "bar", "post", "rock", "small rock", "roof", "person", "grass",
)  # fmt: skip
# Neither drivable nor an obstacle: solids above the robot, and stones that it may or may not climb.
HARMLESS: frozenset[Kind] = frozenset({"crown", "roof", "small rock", "grass"})
ELLIPSOID, CYLINDER, BOX, GRASS = 0, 1, 2, 3
SOLID = np.dtype(
    [
        ("shape", "i8"),
        ("kind", "i8"),
        ("centre_m", "f8", 3),
        ("half_m", "f8", 3),
        ("yaw_rad", "f8"),
        ("free_path_m", "f8"),
    ]
)
Solids = NDArray[np.void]


@dataclass(frozen=True)
class Solid:
    """A planned solid."""

    kind: Kind
    shape: int
    centre_m: tuple[float, float, float]
    half_m: tuple[float, float, float]
    yaw_rad: float = 0.0
    free_path_m: float = 0.0


def as_rows(solids: list[Solid]) -> Solids:
    """Return the rows of these solids."""
    rows = [
        (solid.shape, KINDS.index(solid.kind), solid.centre_m, solid.half_m, solid.yaw_rad, solid.free_path_m)
        for solid in solids
    ]
    return np.array(rows, SOLID)


def outside_m(points: Array, row: np.void) -> Array:
    """Return the distance of points (N, 3) from a solid, negative inside; for an ellipsoid to first order."""
    c, s = np.cos(row["yaw_rad"]), np.sin(row["yaw_rad"])
    away = points - row["centre_m"]
    local = np.stack([c * away[:, 0] + s * away[:, 1], c * away[:, 1] - s * away[:, 0], away[:, 2]], axis=1)
    half = row["half_m"]
    if row["shape"] == ELLIPSOID:
        scaled = np.linalg.norm(local / half, axis=1)
        steep = np.linalg.norm(local / half**2, axis=1)
        return np.asarray(scaled * (scaled - 1) / np.maximum(steep, 1e-9))
    if row["shape"] == BOX:
        return _outside(np.abs(local) - half)
    radial = np.hypot(local[:, 0], local[:, 1]) - half[0]
    return _outside(np.stack([radial, np.abs(local[:, 2]) - half[2]], axis=1))


def _outside(over: Array) -> Array:
    """Return the signed distance of a product of intervals, by the distances (N, k) beyond each."""
    beyond = np.linalg.norm(np.maximum(over, 0.0), axis=1)
    return np.asarray(beyond + np.minimum(over.max(axis=1), 0.0))
