"""Triangle soups of simple objects that stand on the ground.

**Conventions.** A soup is (T, 3, 3) float64: triangles × corners × xyz, metres, around the object's foot.
"""

import numpy as np

from stone.geometry.se3 import Array


def boulder(radius_m: Array, rng: np.random.Generator) -> Array:
    """Return a dented ball of half-axes `radius_m` (3,)."""
    points = _ball_points(6, 9)
    points *= 1 + 0.14 * rng.standard_normal((len(points), 1))
    return (points * radius_m)[_ball_faces(6, 9)]


def leaves(half_axes_m: Array, count: int, size_m: float, rng: np.random.Generator) -> Array:
    """Return loose triangles scattered through an ellipsoid, which let some rays through, like foliage."""
    centre = rng.standard_normal((count, 3))
    centre *= rng.random((count, 1)) ** (1 / 3) / np.linalg.norm(centre, axis=1, keepdims=True)
    return (centre * half_axes_m)[:, None] + size_m * rng.standard_normal((count, 3, 3))


def trunk(radius_m: float, height_m: float) -> Array:
    """Return an open tube of ten sides, from 0.5 m below its foot."""
    angle = 2 * np.pi * np.arange(11) / 10
    ring = radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    low = np.concatenate([ring, np.full((11, 1), -0.5)], axis=1)
    high = np.concatenate([ring, np.full((11, 1), height_m)], axis=1)
    return np.concatenate(
        [np.stack([low[:-1], low[1:], high[:-1]], axis=1), np.stack([low[1:], high[1:], high[:-1]], axis=1)]
    )


def wall(length_m: float, thickness_m: float, height_m: float, yaw_rad: float) -> Array:
    """Return a box from 1.5 m below its foot."""
    corner = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
    corner *= (length_m, thickness_m, height_m + 1.5)
    corner[:, 2] -= 1.5
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    corner[:, :2] = corner[:, :2] @ np.array([[c, s], [-s, c]])
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [1, 5, 7, 3], [0, 2, 6, 4]])
    return np.concatenate([corner[quads[:, [0, 1, 2]]], corner[quads[:, [0, 2, 3]]]])


def blades(count: int, spread_m: float, rng: np.random.Generator) -> Array:
    """Return thin upright blades of grass, 0.12–0.35 m tall."""
    foot = spread_m * rng.standard_normal((count, 2))
    side = 0.02 * rng.standard_normal((count, 2))
    soup = np.zeros((count, 3, 3))
    soup[:, 0, :2], soup[:, 1, :2] = foot - side, foot + side
    soup[:, 2, :2] = foot + 0.06 * rng.standard_normal((count, 2))
    soup[:, 2, 2] = rng.uniform(0.12, 0.35, count)
    return soup


def _ball_points(rings: int, sides: int) -> Array:
    polar = np.pi * (np.arange(rings) + 0.5) / rings
    angle = 2 * np.pi * np.arange(sides) / sides
    x, y = np.sin(polar)[:, None] * np.cos(angle), np.sin(polar)[:, None] * np.sin(angle)
    body = np.stack([x, y, np.broadcast_to(np.cos(polar)[:, None], x.shape)], axis=-1).reshape(-1, 3)
    return np.concatenate([body, [[0, 0, 1.0], [0, 0, -1.0]]])


def _ball_faces(rings: int, sides: int) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    ring, side = (g.ravel() for g in np.meshgrid(np.arange(rings - 1), np.arange(sides), indexing="ij"))
    here, right = ring * sides + side, ring * sides + (side + 1) % sides
    around, beside = np.arange(sides), (np.arange(sides) + 1) % sides
    top, bottom, last = rings * sides, rings * sides + 1, (rings - 1) * sides
    return np.concatenate(
        [
            np.stack([here, here + sides, right], axis=1),
            np.stack([right, here + sides, right + sides], axis=1),
            np.stack([np.full(sides, top), around, beside], axis=1),
            np.stack([np.full(sides, bottom), last + beside, last + around], axis=1),
        ]
    )
