"""Comparison of the two label profiles on the voxels of one map.

**Conventions.** Counted are the voxels of the map, each once, not of the frames: a frame's grid is cut out of the map,
and a voxel that a hundred frames see is still one place.
"""

from collections.abc import Sequence as Listing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.labeler.map.outliers import alternative_reference
from services.labeler.map.surface import TileSummary
from services.labeler.parameters import LabelParameters, other_profile, other_profile_of
from services.labeler.run import LabelRun
from services.labeler.scratch import Arrays, load, save
from stone.labels.traversability import (
    NON_TRAVERSABLE,
    TRAVERSABLE,
    Reference,
    classify,
    distance_squared,
    reference_of,
    threshold,
    total_of,
)
from stone.sensors.sequence import Sequence
from stone.surface.terrain import with_elevation

COMPARISON = "profiles.npz"
CLASSES = ("traversable", "potentially_traversable", "non_traversable")


# Outside this many standard deviations of the driven elevation, profile `paper` calls any ground N (√χ²(3, 0.95)).
RELIEF_SIGMAS = 2.8
NARROW_BAND_M = 3.2  # half the height of a label grid


@dataclass(frozen=True)
class Relief:
    """Profile `paper` measures elevation against where the robot drove: ground farther than about `paper_band_m` above
    or below its mean is N whatever its shape. That is no matter while the band `is_spanned`."""

    track_span_m: float
    paper_band_m: float
    is_spanned: bool


def relief_of(sequence: Sequence, paper_reference: Reference) -> Relief:
    """What elevations the track met, and what the reference of profile `paper` makes of them."""
    z = sequence.frames.map_from_ego.translation_m[:, 2]
    band_m = RELIEF_SIGMAS * float(np.sqrt(paper_reference.covariance[0, 0]))
    return Relief(round(float(np.ptp(z)), 3), round(band_m, 3), band_m > NARROW_BAND_M)


def other_reference(parameters: LabelParameters, tiles: Listing[TileSummary]) -> Reference:
    """What the profile that was not asked for holds driven ground to be; at least one tile."""
    return reference_of(total_of([tile.other_sums for tile in tiles]), other_profile(parameters).reference)


@dataclass(frozen=True, eq=False)
class ProfileComparison:
    """`counts` (3, 3): voxels that are T, P, N in the run's own profile (rows) and in the other (columns).

    `driven` of them are T, of which `unlike` would be N were they not: their D² is beyond the threshold. `reestimated`
    have another class by the reference that is estimated the other way (`services.labeler.map.outliers`).
    """

    counts: NDArray[np.int64]
    driven: int = 0
    unlike: int = 0
    reestimated: int = 0

    @property
    def reestimated_ratio(self) -> float:
        """The share of the map's voxels."""
        return self.reestimated / max(int(self.counts.sum()), 1)

    def as_record(self, parameters: LabelParameters) -> dict[str, Any]:
        """Shares of the map's voxels: of each class in each profile, and of those that would change theirs."""
        voxels = max(int(self.counts.sum()), 1)
        own, other = self.counts.sum(axis=1), self.counts.sum(axis=0)
        return {
            "voxels": int(self.counts.sum()),
            "class_share": {
                parameters.profile: _shares(own, voxels),
                other_profile_of(parameters.profile): _shares(other, voxels),
            },
            "differing_share": round(1.0 - float(np.trace(self.counts)) / voxels, 6) if self.counts.any() else 0.0,
        }


class ComparisonCounter:
    """Counts tile after tile."""

    def __init__(self, run: LabelRun, tiles: Listing[TileSummary], reference: Reference) -> None:
        self._own = reference
        self._alpha = run.parameters.reference.alpha
        self._reference = other_reference(run.parameters, tiles)
        self._alternative = alternative_reference(tiles, run.parameters)
        self.comparison = ProfileComparison(np.zeros((3, 3), np.int64))

    def add(self, arrays: Arrays, classes: NDArray[np.uint8]) -> None:
        """One tile as the surface stage left it, and the classes (K,) of its voxels in the run's own profile."""
        features = with_elevation(arrays["features"], arrays["other_height_m"])  # type: ignore[arg-type]
        others = classify(features, arrays["is_driven"], self._reference, self._alpha)  # type: ignore[arg-type]
        bins = np.arange(TRAVERSABLE, NON_TRAVERSABLE + 2) - 0.5
        pairs, _, _ = np.histogram2d(classes, others, (bins, bins))
        is_driven: NDArray[np.bool_] = arrays["is_driven"]  # type: ignore[assignment]
        squared = distance_squared(arrays["features"][is_driven], self._own)  # type: ignore[arg-type]
        before = self.comparison
        self.comparison = ProfileComparison(
            before.counts + pairs.astype(np.int64),
            before.driven + len(squared),
            before.unlike + int((squared > threshold(self._alpha)).sum()),
            before.reestimated + self._reestimated(arrays, classes),
        )

    def _reestimated(self, arrays: Arrays, classes: NDArray[np.uint8]) -> int:
        if self._alternative is None:
            return 0
        others = classify(arrays["features"], arrays["is_driven"], self._alternative, self._alpha)  # type: ignore[arg-type]
        return int((others != classes).sum())


def comparison_path(run: LabelRun) -> Path:
    return run.scratch / COMPARISON


def save_comparison(run: LabelRun, comparison: ProfileComparison) -> None:
    told = np.array([comparison.driven, comparison.unlike, comparison.reestimated], np.int64)
    save(comparison_path(run), {"counts": comparison.counts, "driven": told})


def load_comparison(run: LabelRun) -> ProfileComparison:
    arrays = load(comparison_path(run))
    return ProfileComparison(arrays["counts"], *arrays["driven"].tolist())  # type: ignore[arg-type]


def _shares(counts: NDArray[np.int64], total: int) -> dict[str, float]:
    return {name: round(float(n) / total, 6) for name, n in zip(CLASSES, counts, strict=True)}
