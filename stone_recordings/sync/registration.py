"""Registration of two point clouds (`small_gicp`, Koide et al., 2021) with measures of its reliability.

**Conventions.** A result is accepted if enough of the source overlaps a surface of the target (`overlap`), and if it is
close to the surface's plane (`residual_m`). Starts displaced along the ground must also converge to the same pose. On a
bare plane every pose fits equally well, so convergence alone is no evidence. One thread computes it, so equal clouds
give equal results.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3, apart
from stone.sensors.clocks import MAD_TO_SIGMA

NEIGHBOURS = 10
COARSE_M, FINE_M = 2.0, 0.5
DISPLACED_M = 0.7
ITERATIONS = 40
FEWEST_POINTS = 200

Points = NDArray[np.float64]


@dataclass(frozen=True)
class Trust:
    """Limits for accepting a registration: overlap within `FINE_M` of the target, typical distance from its planes, and
    the spread (m, rad) of the results of displaced starts.

    Displaced starts are tried only if the position matters and not the turn alone. Measured on the KITTI piece: right
    results 0.028 to 0.037 m, wrong ones from 0.082 m.
    """

    least_overlap: float = 0.5
    residual_m: float = 0.06
    spread_m: float = 0.15
    spread_rad: float = 0.02
    is_place_asked: bool = True


@dataclass(frozen=True, eq=False)
class Registered:
    """`target_from_source`, and the reason why it is rejected ("" if it is accepted)."""

    target_from_source: SE3
    overlap: float
    residual_m: float
    doubt: str


class Target:
    """The cloud (N, 3) to which others are registered; thinned to `sampling_m`."""

    def __init__(self, points: Points, sampling_m: float) -> None:
        import small_gicp

        self._gicp, self._sampling_m, self._is_empty = small_gicp, sampling_m, len(points) < FEWEST_POINTS
        self._cloud, self._tree = small_gicp.preprocess_points(points, sampling_m, NEIGHBOURS, 1)
        self._points, self._normals = self._cloud.points()[:, :3], self._cloud.normals()[:, :3]

    def register(self, source: Points, guess: SE3, trust: Trust) -> Registered:
        """Register the source (M, 3), starting from `guess` and from poses around it."""
        if self._is_empty or len(source) < FEWEST_POINTS:
            return Registered(guess, 0.0, 0.0, "too few points")
        cloud, _ = self._gicp.preprocess_points(source, self._sampling_m, NEIGHBOURS, 1)
        if min(cloud.size(), len(self._points)) < FEWEST_POINTS:
            return Registered(guess, 0.0, 0.0, "too few points")
        best = self._aligned(cloud, guess)
        if best is None:
            return Registered(guess, 0.0, 0.0, "the registration does not converge")
        overlap, residual_m = self._fit(cloud.points()[:, :3], best)
        if overlap < trust.least_overlap:
            return Registered(best, overlap, residual_m, f"only {overlap:.0%} of what is seen after it overlaps")
        if residual_m > trust.residual_m:
            return Registered(best, overlap, residual_m, f"the surfaces are {residual_m:.2f} m apart")
        if trust.is_place_asked and not all(self._agrees(cloud, best, start, trust) for start in _displaced(guess)):
            return Registered(best, overlap, residual_m, "more than one place fits")
        return Registered(best, overlap, residual_m, "")

    def _aligned(self, cloud: Any, start: SE3) -> SE3 | None:
        for reach_m in (COARSE_M, FINE_M):
            result = self._gicp.align(
                self._cloud,
                cloud,
                self._tree,
                start.as_matrix(),
                max_correspondence_distance=reach_m,
                num_threads=1,
                max_iterations=ITERATIONS,
            )
            if not np.isfinite(result.T_target_source).all() or not result.num_inliers:
                return None
            start = SE3.from_matrix(np.asarray(result.T_target_source))
        return start if result.converged else None

    def _fit(self, source: Points, target_from_source: SE3) -> tuple[float, float]:
        """Return the overlap, and the median distance of the overlapping points from the planes, as a standard
        deviation.
        """
        from scipy.spatial import cKDTree  # loaded on use: `stone inspect` never reaches it

        placed = target_from_source @ source
        gap_m, nearest = cKDTree(self._points).query(placed, distance_upper_bound=FINE_M)
        rows = np.flatnonzero(np.isfinite(gap_m))
        if not len(rows):
            return 0.0, np.inf
        off = placed[rows] - self._points[nearest[rows]]
        off_m = np.abs(np.sum(off * self._normals[nearest[rows]], axis=1))
        return len(rows) / len(source), MAD_TO_SIGMA * float(np.median(off_m))

    def _agrees(self, cloud: Any, best: SE3, start: SE3, trust: Trust) -> bool:
        other = self._aligned(cloud, start)
        if other is None:
            return False
        apart_m, apart_rad = apart(best, other)
        return apart_m <= trust.spread_m and apart_rad <= trust.spread_rad


def _displaced(guess: SE3) -> Iterator[SE3]:
    """Yield poses in front of, behind and on both sides of a start."""
    for shift_m in ([1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0]):
        yield guess @ SE3.from_parts(np.array([1.0, 0, 0, 0]), DISPLACED_M * np.array(shift_m))
