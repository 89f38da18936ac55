"""Rigid transforms in three dimensions, one or many at a time.

**Conventions.** A transform is named `dst_from_src` and maps coordinates in `src` to coordinates in `dst`, so inner
names cancel: `map_from_lidar = map_from_ego @ ego_from_lidar`. Quaternions are `wxyz` of unit norm, float64.
Leading axes are batch axes and broadcast as in numpy. The layout (one array, `@` for compose and apply) follows
viser's `transforms`.
"""

from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import NDArray

from stone.errors import ShapeError

Array = NDArray[np.float64]

# Below this angle sin(θ) loses digits and the chord equals the arc to 1e-13, so interpolate linearly.
LINEAR_BELOW_RAD = 1e-6


@dataclass(frozen=True, eq=False)
class SE3:
    """`dst_from_src`: rotate by the unit quaternion, then translate; `wxyz_xyz` is (..., 7), metres."""

    wxyz_xyz: Array

    def __post_init__(self) -> None:
        if self.wxyz_xyz.shape[-1:] != (7,):
            raise ShapeError("wxyz_xyz", self.wxyz_xyz.shape, "(..., 7)")

    @staticmethod
    def identity(batch: tuple[int, ...] = ()) -> "SE3":
        return SE3(np.broadcast_to(np.array([1.0, 0, 0, 0, 0, 0, 0]), (*batch, 7)).copy())

    @staticmethod
    def from_parts(wxyz: Array, translation_m: Array) -> "SE3":
        """Return the transform with a quaternion (..., 4), normalised here, and a translation (..., 3)."""
        unit = wxyz / np.linalg.norm(wxyz, axis=-1, keepdims=True)
        batch = np.broadcast_shapes(unit.shape[:-1], translation_m.shape[:-1])
        parts = (np.broadcast_to(unit, (*batch, 4)), np.broadcast_to(translation_m, (*batch, 3)))
        return SE3(np.concatenate(parts, axis=-1).astype(np.float64))

    @staticmethod
    def from_matrix(matrix: Array) -> "SE3":
        """Return the transform of a homogeneous matrix (..., 4, 4), whose rotation block must be a rotation."""
        if matrix.shape[-2:] != (4, 4):
            raise ShapeError("matrix", matrix.shape, "(..., 4, 4)")
        return SE3.from_parts(wxyz_from_rotation(matrix[..., :3, :3]), matrix[..., :3, 3])

    @property
    def wxyz(self) -> Array:
        return self.wxyz_xyz[..., :4]

    @property
    def translation_m(self) -> Array:
        return self.wxyz_xyz[..., 4:]

    @property
    def batch(self) -> tuple[int, ...]:
        return self.wxyz_xyz.shape[:-1]

    def __len__(self) -> int:
        return int(self.wxyz_xyz.shape[0])

    def __getitem__(self, index: int | slice | NDArray[np.integer] | NDArray[np.bool_]) -> "SE3":
        return SE3(self.wxyz_xyz[index])

    def rotation(self) -> Array:
        """Rotation matrices (..., 3, 3)."""
        w, x, y, z = _components(self.wxyz)
        rows = (
            *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        )
        return _side_by_side(rows).reshape(*self.batch, 3, 3)

    def as_matrix(self) -> Array:
        """Homogeneous matrices (..., 4, 4)."""
        matrix = np.zeros((*self.batch, 4, 4))
        matrix[..., :3, :3] = self.rotation()
        matrix[..., :3, 3] = self.translation_m
        matrix[..., 3, 3] = 1.0
        return matrix

    def inverse(self) -> "SE3":
        conjugate = self.wxyz * np.array([1.0, -1.0, -1.0, -1.0])
        return SE3.from_parts(conjugate, -rotate(conjugate, self.translation_m))

    @overload
    def __matmul__(self, other: "SE3") -> "SE3": ...
    @overload
    def __matmul__(self, other: Array) -> Array: ...
    def __matmul__(self, other: "SE3 | Array") -> "SE3 | Array":
        """Compose with a transform, or apply to points (..., 3) that broadcast against the batch."""
        if isinstance(other, SE3):
            return SE3.from_parts(
                multiply(self.wxyz, other.wxyz), rotate(self.wxyz, other.translation_m) + self.translation_m
            )
        return rotate(self.wxyz, other) + self.translation_m


def multiply(a_wxyz: Array, b_wxyz: Array) -> Array:
    """Return the Hamilton product: the rotation `b`, then `a`."""
    aw, ax, ay, az = _components(a_wxyz)
    bw, bx, by, bz = _components(b_wxyz)
    product = (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )
    return _side_by_side(product)


def rotate(wxyz: Array, vectors: Array) -> Array:
    """Return vectors (..., 3) rotated by unit quaternions (..., 4)."""
    w = wxyz[..., 0]
    axis = (wxyz[..., 1], wxyz[..., 2], wxyz[..., 3])
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    u, v, t = (2.0 * component for component in _cross(axis, (x, y, z)))
    i, j, k = _cross(axis, (u, v, t))
    return _side_by_side((x + w * u + i, y + w * v + j, z + w * t + k))


def _components(wxyz: Array) -> tuple[Array, Array, Array, Array]:
    return wxyz[..., 0], wxyz[..., 1], wxyz[..., 2], wxyz[..., 3]


def _side_by_side(parts: tuple[Array, ...]) -> Array:
    """Return arrays of one shape along a new last axis; faster than `np.stack` for a single pose."""
    out = np.empty((*np.shape(parts[0]), len(parts)))
    for at, part in enumerate(parts):
        out[..., at] = part
    return out


def _cross(a: tuple[Array, Array, Array], b: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
    """Return the cross product by components; numpy's has a large overhead for single vectors."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def steps_of(poses: SE3) -> tuple[Array, Array]:
    """Return distance (K − 1,) in metres and angle (K − 1,) in [0, π] between consecutive poses."""
    lengths_m = np.linalg.norm(np.diff(poses.translation_m, axis=0), axis=1)
    turns = multiply(poses.wxyz[:-1] * np.array([1.0, -1.0, -1.0, -1.0]), poses.wxyz[1:])
    return lengths_m, 2 * np.arctan2(np.linalg.norm(turns[:, 1:], axis=1), np.abs(turns[:, 0]))


def shortest_turn_to_z(up: Array) -> Array:
    """Return the quaternion that turns the unit vector `up` (3,) to z; about x if it points straight down."""
    half = np.array([1 + up[2], up[1], -up[0], 0.0])
    size = float(np.linalg.norm(half))
    return half / size if size > 1e-9 else np.array([0.0, 1.0, 0.0, 0.0])


def apart(a: SE3, b: SE3) -> tuple[float, float]:
    """Return the distance in metres and the angle in radians between two single transforms."""
    turned = (b @ a.inverse()).wxyz
    angle = 2 * np.arctan2(np.linalg.norm(turned[1:]), abs(turned[0]))
    return float(np.linalg.norm(b.translation_m - a.translation_m)), float(angle)


def wxyz_from_rotation(rotation: Array) -> Array:
    """Return unit quaternions with w ≥ 0 of rotation matrices (..., 3, 3), by the largest component (Shepperd,
    1978).
    """
    r = rotation
    trace = np.trace(r, axis1=-2, axis2=-1)
    squares = np.stack([trace, r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]], axis=-1)
    s = r - np.swapaxes(r, -1, -2)
    a = r + np.swapaxes(r, -1, -2)
    base = 1.0 - trace
    candidates = np.stack(
        [
            np.stack([1.0 + trace, s[..., 2, 1], s[..., 0, 2], s[..., 1, 0]], axis=-1),
            np.stack([s[..., 2, 1], base + 2 * r[..., 0, 0], a[..., 0, 1], a[..., 0, 2]], axis=-1),
            np.stack([s[..., 0, 2], a[..., 0, 1], base + 2 * r[..., 1, 1], a[..., 1, 2]], axis=-1),
            np.stack([s[..., 1, 0], a[..., 0, 2], a[..., 1, 2], base + 2 * r[..., 2, 2]], axis=-1),
        ],
        axis=-2,
    )
    best = np.argmax(squares, axis=-1)
    chosen = np.take_along_axis(candidates, best[..., None, None], axis=-2)[..., 0, :]
    unit = chosen / np.linalg.norm(chosen, axis=-1, keepdims=True)
    return np.asarray(np.where(unit[..., :1] < 0, -unit, unit), dtype=np.float64)


def slerp(a_wxyz: Array, b_wxyz: Array, ratio: Array) -> Array:
    """Interpolate unit quaternions along the shortest arc: `a` at ratio 0, `b` at 1 (Shoemake, 1985).

    `ratio` has the batch shape. The angle comes from atan2(|a−b|, |a+b|), which is accurate near 0 and π.
    """
    b = np.where(np.sum(a_wxyz * b_wxyz, axis=-1, keepdims=True) < 0, -b_wxyz, b_wxyz)
    angle = 2 * np.arctan2(np.linalg.norm(a_wxyz - b, axis=-1), np.linalg.norm(a_wxyz + b, axis=-1))
    is_small = angle < LINEAR_BELOW_RAD
    sine = np.where(is_small, 1.0, np.sin(angle))
    weight_a = np.where(is_small, 1 - ratio, np.sin((1 - ratio) * angle) / sine)
    weight_b = np.where(is_small, ratio, np.sin(ratio * angle) / sine)
    blend = weight_a[..., None] * a_wxyz + weight_b[..., None] * b
    return np.asarray(blend / np.linalg.norm(blend, axis=-1, keepdims=True), dtype=np.float64)


def interpolate(a: SE3, b: SE3, ratio: Array) -> SE3:
    """Interpolate between two transforms: position linearly, orientation by `slerp` (paper, III-C)."""
    position = (1 - ratio)[..., None] * a.translation_m + ratio[..., None] * b.translation_m
    return SE3.from_parts(slerp(a.wxyz, b.wxyz, ratio), position)
