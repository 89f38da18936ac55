"""Rays through a grid of voxels, followed step by step: a reference for sight and observation."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stone.labels.voxels import VOXEL_M
from stone_base.label_grid import PAPER

Array = NDArray[np.floating]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]


def in_voxels(points_ego: ArrayLike) -> Array:
    """Return ego points (N, 3) in voxels of the grid, from its lowest corner."""
    return np.asarray((np.asarray(points_ego) - np.array(PAPER.min_m)) / VOXEL_M)


def cast(occupied: Mask, begin: Array, end: Array) -> tuple[Indices, Mask]:
    """Return (voxel (R, 3) in which each line begin → end (R, 3) stops, every voxel of the grid that any line entered).

    A line stops in the first occupied voxel, otherwise at its end. Amanatides & Woo (1987), all lines step by step.
    """
    begin = np.broadcast_to(begin, end.shape).astype(np.float64)
    way, at, last = end - begin, np.floor(begin).astype(np.int64), np.floor(end).astype(np.int64)
    step = np.sign(way).astype(np.int64)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(step != 0, (at + (step > 0) - begin) / way, np.inf)
        growth = np.where(step != 0, np.abs(1 / way), np.inf)
    stops, passed, ray = at.copy(), np.zeros(occupied.shape, np.bool_), np.arange(len(end))
    while len(ray):
        inside = np.all((at >= 0) & (at < occupied.shape), axis=1).reshape(-1)
        voxel = tuple(np.where(inside[:, None], at, 0).T)
        passed[tuple(at[inside].T)] = True
        stops[ray] = at
        going = ~(inside & occupied[voxel]) & (at != last).any(axis=1) & (ratio.min(axis=1) <= 1)
        ray, at, last, step, ratio, growth = (rows[going] for rows in (ray, at, last, step, ratio, growth))
        row, axis = np.arange(len(ray)), np.argmin(ratio, axis=1) if len(ray) else np.zeros(0, np.int64)
        at[row, axis] += step[row, axis]
        ratio[row, axis] += growth[row, axis]
    return stops, passed


def open_share(occupied: Mask, camera: Array, voxels: Indices, rays: int, seed: int) -> Array:
    """Return the share of `rays` rays from the camera to random points in each voxel (N, 3) that reach it, (N,)."""
    targets = np.repeat(voxels, rays, axis=0)
    return _reaching(occupied, camera, targets + np.random.default_rng(seed).uniform(0, 1, targets.shape), rays)


def lit_share(occupied: Mask, camera: Array, voxels: Indices, rays: int, seed: int) -> Array:
    """Do as `open_share`, for random points on the sides of the voxels that face the camera."""
    rng = np.random.default_rng(seed)
    targets = np.repeat(voxels, rays, axis=0)
    gap = camera - (targets + 0.5)
    axis = np.argmax(np.where(np.abs(gap) > 0.5, rng.uniform(0.1, 1, gap.shape), 0), axis=1)
    places, row = rng.random((len(gap), 3)), np.arange(len(gap))
    places[row, axis] = np.where(gap[row, axis] > 0, 1 - 1e-9, 1e-9)
    return _reaching(occupied, camera, targets + places, rays)


def _reaching(occupied: Mask, camera: Array, targets: Array, rays: int) -> Array:
    stops, _ = cast(occupied, camera, targets)
    return np.asarray((stops == np.floor(targets)).all(axis=1).reshape(-1, rays).mean(axis=1))
