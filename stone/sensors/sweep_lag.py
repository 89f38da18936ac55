"""The lag of the poses behind the LiDAR's sweeps, from the turns between sweeps that registration measured.

    turn of the sweeps(t₁, t₂) ≈ b + turn of the poses(t₁ + lag, t₂ + lag), with the lag of the best agreement

**Conventions.** A turn is a rotation from the ego frame at its end to the ego frame at its start, `wxyz`. All three
axes are used, because rough ground rolls and pitches a robot faster than it yaws. A constant error (`b`, from the
mount) is removed by a median. A positive lag means that the poses' stamps are late, a negative lag that the sweeps'
are. Least squares by Gauss–Newton; each turn is weighted by one over its distance, so that wrong turns have little
effect. The standard error is that of least squares. It does not include the effect of late poses on the deskewed
sweeps. On simulated drives, a lag of 0.2 s is underestimated by up to 20 %.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import multiply
from stone.geometry.smooth_interpolation import rotation_vectors
from stone.geometry.trajectory import Trajectory

MAX_LAG_S, COARSE_STEP_S, SLOPE_STEP_S = 0.4, 0.02, 0.01
ROUNDS = 8
LEAST_TURN_RAD = 1e-5
FEWEST_TURNS = 8

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SweepTurns:
    """K turns `wxyz` (K, 4) between sweeps stamped `begin_ns` and `end_ns` (K,)."""

    begin_ns: NDArray[np.int64]
    end_ns: NDArray[np.int64]
    wxyz: Array

    def __len__(self) -> int:
        return len(self.begin_ns)


@dataclass(frozen=True)
class SweepLag:
    """The lag of the poses, its standard error, and the typical difference of the sweeps' and the poses' turns with and
    without the lag.
    """

    turns: int
    lag_ns: int
    sigma_ns: int
    residual_rad: float
    unshifted_rad: float


def sweep_lag(turns: SweepTurns, track: Trajectory, max_gap_ns: int) -> SweepLag | None:
    """Return the lag. Return None for fewer than `FEWEST_TURNS` within the track, for turns that do not depend on time,
    and for a best agreement at the end of the search (± `MAX_LAG_S`).
    """
    residual = _Residuals(turns, track, max_gap_ns)
    searched = np.arange(-MAX_LAG_S, MAX_LAG_S + COARSE_STEP_S / 2, COARSE_STEP_S)
    typical = np.array([_typical(residual.at(float(lag_s))) for lag_s in searched])
    if not np.isfinite(typical).any():
        return None
    best = int(np.nanargmin(typical))
    if best in (0, len(searched) - 1):
        return None
    refined = _refined(residual, float(searched[best]))
    if refined is None:
        return None
    lag_s, sigma_s = refined
    at_lag, unshifted = (_typical(residual.at(at_s)) for at_s in (lag_s, 0.0))
    return SweepLag(len(turns), round(lag_s * 1e9), round(sigma_s * 1e9), at_lag, unshifted)


@dataclass(frozen=True, eq=False)
class _Residuals:
    turns: SweepTurns
    track: Trajectory
    max_gap_ns: int

    def at(self, lag_s: float) -> Array:
        """Return the rotation vectors (K, 3) from the sweeps' turns to the poses' turns at this lag; NaN outside the
        track.
        """
        shift_ns = round(lag_s * 1e9)
        begin = self.track.at(self.turns.begin_ns + shift_ns, self.max_gap_ns)
        end = self.track.at(self.turns.end_ns + shift_ns, self.max_gap_ns)
        of_poses = (begin.map_from_ego.inverse() @ end.map_from_ego).wxyz
        vectors = rotation_vectors(multiply(self.turns.wxyz * np.array([1.0, -1, -1, -1]), of_poses))
        vectors[begin.segment != end.segment] = np.nan
        return vectors


def _beside_median(vectors: Array) -> Array:
    """Return the known rows (N, 3) without their common part."""
    known = vectors[np.isfinite(vectors).all(axis=1)]
    return np.asarray(known - np.median(known, axis=0)) if len(known) else known


def _typical(vectors: Array) -> float:
    """Return the median length of the rows without their common part; NaN for fewer than `FEWEST_TURNS` known ones."""
    own = _beside_median(vectors)
    return float(np.median(np.linalg.norm(own, axis=1))) if len(own) >= FEWEST_TURNS else float("nan")


def _refined(residual: _Residuals, lag_s: float) -> tuple[float, float] | None:
    """Return (lag, standard error) in s; None if fewer than `FEWEST_TURNS` lie within the track or no turn changes."""
    error_s = np.inf
    for _ in range(ROUNDS):
        here, later, earlier = (residual.at(lag_s + step_s) for step_s in (0.0, SLOPE_STEP_S, -SLOPE_STEP_S))
        known = np.isfinite(here + later + earlier).all(axis=1)
        if known.sum() < FEWEST_TURNS:
            return None
        slope = (later - earlier)[known] / (2 * SLOPE_STEP_S)
        slope, off = slope - slope.mean(axis=0), _beside_median(here[known])
        lengths = np.maximum(np.linalg.norm(off, axis=1), LEAST_TURN_RAD)
        weights = np.minimum(1 / lengths, 1 / np.median(lengths))[:, None]
        energy = float((weights * slope**2).sum())
        if energy == 0:
            return None
        change_s = -float((weights * slope * off).sum()) / energy
        variance = float((weights**2 * slope**2 * off**2).sum()) / energy**2
        error_s, lag_s = float(np.sqrt(variance)), lag_s + float(np.clip(change_s, -COARSE_STEP_S, COARSE_STEP_S))
    return lag_s, error_s
