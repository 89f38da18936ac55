"""Eq. 1–6 of the paper written down once more, in plain loops, sharing no code with `stone`: the oracle of `paper`.

**Conventions.** As in the paper: h elevation, theta slope, r roughness; voxels are tuples of three integers.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation, Slerp
from scipy.stats import chi2

VOXEL_M = 0.2


@dataclass(frozen=True)
class Constants:
    """Those of the paper and, where it is silent, of the design."""

    k: int = 20
    alpha: float = 0.05
    floor_m2: float = 1e-6
    band_m: float = 0.15
    step_m: float = 0.1
    size_m: tuple[float, float] = (1.06, 0.85)


def voxel_of(point):
    return tuple(int(np.floor(c / VOXEL_M)) for c in point)


def vertex_normals(vertices, triangles):
    """The normalised mean of the unit normals of the faces around each vertex."""
    sums = np.zeros_like(vertices)
    for a, b, c in triangles:
        normal = np.cross(vertices[b] - vertices[a], vertices[c] - vertices[a])
        length = np.linalg.norm(normal)
        for corner in (a, b, c):
            sums[corner] += normal / length if length > 0 else 0.0
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return sums / np.where(lengths > 0, lengths, 1.0)


def roughness(vertices, constants):
    """Eq. 3 with the k nearest vertices that lie no more than two voxels away along any axis."""
    tree, cells = cKDTree(vertices), np.floor(vertices / VOXEL_M)
    _, nearest = tree.query(vertices, k=min(4 * constants.k, len(vertices)))
    values = []
    for vertex, row in enumerate(nearest):
        near = [n for n in row if np.abs(cells[n] - cells[vertex]).max() <= 2][: constants.k]
        mean_square = 0.0
        if len(near) >= 4:
            off = vertices[near] - vertices[near].mean(axis=0)
            eigenvalues, eigenvectors = np.linalg.eigh(off.T @ off)
            assert eigenvalues[0] <= eigenvalues[1]
            mean_square = np.mean((off @ eigenvectors[:, 0]) ** 2)
        values.append(np.log(max(mean_square, constants.floor_m2)))
    return np.array(values)


def features_by_voxel(vertices, normals, constants):
    """Eq. 1–5: voxel → the mean of (h, theta, r) over its vertices."""
    slope = np.arccos(np.clip(normals[:, 2], -1, 1))
    rough = roughness(vertices, constants)
    found = {}
    for vertex, place in enumerate(vertices):
        found.setdefault(voxel_of(place), []).append((place[2], slope[vertex], rough[vertex]))
    return {voxel: np.mean(rows, axis=0) for voxel, rows in found.items()}


def poses_between(matrices, step_m):
    """The poses (4, 4) and as many between two of them as bring their origins within `step_m`."""
    dense = []
    for a, b in pairwise(matrices):
        pieces = max(1, int(np.ceil(np.linalg.norm(b[:3, 3] - a[:3, 3]) / step_m)))
        turn = Slerp([0, 1], Rotation.from_matrix([a[:3, :3], b[:3, :3]]))
        for piece in range(pieces):
            ratio = piece / pieces
            dense.append((turn(ratio).as_matrix(), (1 - ratio) * a[:3, 3] + ratio * b[:3, 3]))
    return [*dense, (matrices[-1][:3, :3], matrices[-1][:3, 3])]


def driven_voxels(voxels, matrices, constants):
    """T: the voxels whose centre comes under the footprint."""
    half = np.array([*constants.size_m, 2 * constants.band_m]) / 2
    centres = (np.array(list(voxels)) + 0.5) * VOXEL_M
    under = np.zeros(len(centres), bool)
    for rotation, place in poses_between(matrices, constants.step_m):
        under |= (np.abs((centres - place) @ rotation) <= half).all(axis=1)
    return {voxel for voxel, is_under in zip(voxels, under, strict=True) if is_under}


def classes_by_voxel(vertices, normals, matrices, constants):
    """Eq. 1–6: voxel → 1 (T), 2 (P) or 3 (N)."""
    features = features_by_voxel(vertices, normals, constants)
    driven = driven_voxels(list(features), matrices, constants)
    reference = np.array([features[voxel] for voxel in sorted(driven)])
    mean, covariance = reference.mean(axis=0), np.cov(reference.T)
    limit = chi2.ppf(1 - constants.alpha, df=3)
    classes = {}
    for voxel, feature in features.items():
        off = feature - mean
        is_alike = off @ np.linalg.solve(covariance, off) <= limit
        classes[voxel] = 1 if voxel in driven else 2 if is_alike else 3
    return classes
