"""Comparison of the two label profiles on the voxels of one map.

**Conventions.** Counted are the voxels of the map, each once, not of the frames: a frame's grid is cut out of the map,
and a voxel that a hundred frames see is still one place.
"""

from collections.abc import Sequence as Listing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.labeler.map.surface import TileSummary
from services.labeler.parameters import LabelParameters, other_profile, other_profile_of
from services.labeler.results import reference_from
from services.labeler.run import LabelRun
from services.labeler.scratch import Arrays, load, save
from stone.findings import Finding
from stone.labels.robust_scatter import robust_scatter
from stone.labels.traversability import (
    FEW_VOXELS,
    NON_TRAVERSABLE,
    TRAVERSABLE,
    Reference,
    ReferenceParameters,
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
    have another class by the reference that is estimated the other way (below).
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


# Outliers among the driven voxels: what the reference would be without them, by the robust estimate.
#
# **Conventions.** A voxel is far in a feature when it lies more than `FAR_SIGMAS` of that estimate from its mean,
# which one Gaussian voxel in two million does. Both estimates are without the floor that a profile adds.


USUAL_RATIO = 0.25
FAR_SIGMAS = 5.0
FEWEST_FAR_RATIO = 0.002
WIDENED_TIMES = 1.5
NAMES = ("elevation", "slope", "roughness")


@dataclass(frozen=True, eq=False)
class OutlierCounts:
    """Per feature (3,): the mean and the standard deviation without outliers and of all driven voxels, how many of the
    `voxels` are far, and the farthest of them."""

    voxels: int
    mean: NDArray[np.float64]
    sigma: NDArray[np.float64]
    sigma_of_all: NDArray[np.float64]
    far: NDArray[np.int64]
    farthest: NDArray[np.float64]

    def as_record(self) -> dict[str, Any]:
        """By the name of the feature; m, rad, log m²."""
        columns = ("mean", "sigma", "sigma_of_all", "far", "farthest")
        return {name: {column: getattr(self, column)[at].item() for column in columns} for at, name in enumerate(NAMES)}


def outlier_counts(tiles: Listing[TileSummary], parameters: ReferenceParameters) -> OutlierCounts | None:
    """Of all tiles, in the profile's own features; None for fewer than `FEW_VOXELS` driven ones."""
    rows = np.concatenate([tile.driven for tile in tiles])
    if len(rows) < FEW_VOXELS:
        return None
    found = robust_scatter(rows, parameters.outlier_ratio or USUAL_RATIO)
    sigma = np.sqrt(np.diag(found.covariance))
    off = np.abs(rows - found.mean)
    far = (off > FAR_SIGMAS * np.maximum(sigma, np.finfo(float).eps)).sum(axis=0)
    farthest = rows[off.argmax(axis=0), np.arange(rows.shape[1])]
    return OutlierCounts(len(rows), found.mean, sigma, rows.std(axis=0, ddof=1), far, farthest)


def alternative_reference(tiles: Listing[TileSummary], parameters: LabelParameters) -> Reference | None:
    """The robust reference where the run's is the plain one, the plain one where it is not; None below `FEW_VOXELS`."""
    if sum(len(tile.driven) for tile in tiles) < FEW_VOXELS:
        return None
    other = replace(parameters.reference, outlier_ratio=0.0 if parameters.reference.outlier_ratio else USUAL_RATIO)
    return reference_from(list(tiles), replace(parameters, reference=other))


def outlier_findings(counts: OutlierCounts | None, parameters: LabelParameters, changed_ratio: float) -> list[Finding]:
    """LAB-606 for what widens the reference far beyond what most of the driven ground is like."""
    if counts is None or parameters.reference.outlier_ratio:
        return []
    is_wide = counts.sigma_of_all > WIDENED_TIMES * counts.sigma
    spoilt = np.flatnonzero(is_wide & (counts.far > FEWEST_FAR_RATIO * counts.voxels)).tolist()
    if not spoilt:
        return []
    sentence = (
        f"of {counts.voxels} driven voxels some are far from the rest: {'; '.join(_far(counts, at) for at in spoilt)}. "
        "Are non-ground surfaces included, or several kinds of terrain? "
        f"{_advice(parameters)}; {changed_ratio:.1%} of the map's voxels would change their class"
    )
    return [Finding("LAB-606", "warning", "", sentence)]


def _advice(parameters: LabelParameters) -> str:
    option = f"reference.outlier_ratio {USUAL_RATIO}"
    return (
        f"{option} leaves them out" if parameters.profile == "local" else f"profile local with {option} leaves them out"
    )


def _far(counts: OutlierCounts, at: int) -> str:
    """One feature in words."""
    sigma, of_all, farthest = (
        _told(float(values[at]), at) for values in (counts.sigma, counts.sigma_of_all, counts.farthest)
    )
    return f"{counts.far[at]} in {NAMES[at]} (up to {farthest}), whose σ is {of_all} and {sigma} without them"


def _told(value: float, at: int) -> str:
    if NAMES[at] == "slope":
        return f"{np.rad2deg(value):.1f}°"
    return f"{value:.2g} m" if NAMES[at] == "elevation" else f"{value:.2g} log m²"
