"""Adds poses between those of a smooth source, so that linear interpolation and slerp have a smaller error.

A robot on rough ground pitches with 2 rad/s². With INS samples 50 ms apart, slerp alone then has an error of 0.025°, or
12 mm at 50 m. A Lagrange polynomial through the six (at the ends: four) surrounding samples reduces the error to a
twentieth. It is computed in the tangent of the left one of the middle two.

**Conventions.** Samples stay unchanged. The first and last interval of a segment get no poses. Neither does an interval
if one of the three around it is longer than `max_gap_ns`: a polynomial would be a guess. Only for sources that are
smooth between samples; scan-by-scan odometry is not.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3, Array, multiply, rotate
from stone.geometry.trajectory import Trajectory

RATIOS = np.arange(1, 8) / 8
CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])


def with_between(trajectory: Trajectory, max_gap_ns: int) -> Trajectory:
    """Return the trajectory with seven additional poses in every interval with a neighbour on each side."""
    wide = _rows(trajectory, max_gap_ns, 2)
    narrow = np.setdiff1d(_rows(trajectory, max_gap_ns, 1), wide)
    if not len(wide) + len(narrow):
        return trajectory
    additions = [_between(trajectory, rows, reach) for rows, reach in ((narrow, 1), (wide, 2))]
    return _merged(trajectory, *(np.concatenate(parts) for parts in zip(*additions, strict=True)))


def _rows(trajectory: Trajectory, max_gap_ns: int, reach: int) -> NDArray[np.int64]:
    """Return the rows k whose neighbours k − reach to k + 1 + reach are in one segment without long gaps."""
    is_short = np.diff(trajectory.stamps_ns) <= max_gap_ns
    if trajectory.segment is not None:
        is_short &= np.diff(trajectory.segment) == 0
    span = 2 * reach + 1
    if len(is_short) < span:
        return np.zeros(0, np.int64)
    is_even = np.lib.stride_tricks.sliding_window_view(is_short, span).all(axis=1)
    return np.flatnonzero(is_even).astype(np.int64) + reach


def _between(
    trajectory: Trajectory, rows: NDArray[np.int64], reach: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return stamps and `wxyz_xyz` of the poses added after each of these rows, from its 2 · reach + 2 neighbours."""
    around = rows[:, None] + np.arange(-reach, reach + 2)
    times_ns = trajectory.stamps_ns[around] - trajectory.stamps_ns[rows][:, None]
    new_ns = np.round(RATIOS * times_ns[:, reach + 1 : reach + 2]).astype(np.int64)
    weights = _lagrange(times_ns.astype(np.float64), new_ns.astype(np.float64))
    base = trajectory.map_from_ego[rows]
    back = base.wxyz[:, None] * CONJUGATE
    turn_rad = rotation_vectors(multiply(back, trajectory.map_from_ego.wxyz[around]))
    step_m = rotate(back, trajectory.map_from_ego.translation_m[around] - base.translation_m[:, None])
    new = SE3(base.wxyz_xyz[:, None]) @ SE3.from_parts(_exp(weights @ turn_rad), weights @ step_m)
    return (trajectory.stamps_ns[rows][:, None] + new_ns).ravel(), new.wxyz_xyz.reshape(-1, 7)


def _lagrange(nodes: Array, at: Array) -> Array:
    """Return the weights (M, P, n) of the values at `nodes` (M, n) for the polynomial's values at `at` (M, P)."""
    weights = np.ones((*at.shape, nodes.shape[1]))
    for j in range(nodes.shape[1]):
        for i in range(nodes.shape[1]):
            if i != j:
                weights[:, :, j] *= (at - nodes[:, i : i + 1]) / (nodes[:, j : j + 1] - nodes[:, i : i + 1])
    return weights


def rotation_vectors(wxyz: Array) -> Array:
    """Return the rotation vectors (..., 3) of unit quaternions, along the shorter arc."""
    shortest = np.where(wxyz[..., :1] < 0, -wxyz, wxyz)
    sine = np.linalg.norm(shortest[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, shortest[..., :1])
    return np.asarray(shortest[..., 1:] * np.where(sine > 0, angle / np.where(sine > 0, sine, 1), 2.0))


def _exp(turn_rad: Array) -> Array:
    """Return the unit quaternions of rotation vectors (..., 3)."""
    angle = np.linalg.norm(turn_rad, axis=-1, keepdims=True)
    return np.concatenate([np.cos(angle / 2), turn_rad * np.sinc(angle / (2 * np.pi)) / 2], axis=-1)


def _merged(trajectory: Trajectory, new_ns: NDArray[np.int64], new: Array) -> Trajectory:
    """Return old and new poses in stamp order; a new pose with an existing stamp (samples nanoseconds apart) is
    dropped.
    """
    stamps_ns, first = np.unique(np.concatenate([trajectory.stamps_ns, new_ns]), return_index=True)
    poses = np.concatenate([trajectory.map_from_ego.wxyz_xyz, new])[first]
    segment = trajectory.segment
    if segment is not None:
        segment = segment[np.searchsorted(trajectory.stamps_ns, stamps_ns, side="right") - 1]
    return replace(trajectory, stamps_ns=stamps_ns, map_from_ego=SE3(poses), segment=segment)
