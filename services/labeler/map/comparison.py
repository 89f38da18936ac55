"""Comparison of the two label profiles on the voxels of one map.

**Conventions.** The comparison counts each voxel of the map once, not the voxels of frames. Frames are crops of the
map, and a voxel in a hundred frames is still one place.
"""

from collections.abc import Sequence as Listing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.domain.sequences.label_choices import DEFAULT_PROFILE
from services.labeler.frames import LabelledTile, squared_distances
from services.labeler.map.surface import TileSummary
from services.labeler.parameters import CLEAN_MADS, LabelParameters, other_profile, other_profile_of
from services.labeler.results import reference_from
from services.labeler.run import LabelRun
from services.labeler.scratch import load, save
from stone.findings import Finding
from stone.labels.robust_scatter import robust_scatter
from stone.labels.traversability import (
    FEW_VOXELS,
    NON_TRAVERSABLE,
    POTENTIAL,
    TRAVERSABLE,
    Reference,
    classify,
    threshold,
)
from stone.sensors.sequence import Sequence

COMPARISON = "profiles.npz"
CLASSES = ("traversable", "potentially_traversable", "non_traversable")
COUNTED = ("driven", "unlike", "beyond", "reestimated", "steep", "steep_p", "steep_p_other")
STEEPER_DEG = 5.0  # above the vehicle's limit: no measurement error makes such ground drivable


# Outside this many standard deviations of the driven elevation, profile `paper` labels any ground N (√χ²(3, 0.95)).
RELIEF_SIGMAS = 2.8
NARROW_BAND_M = 3.2  # half the height of a label grid


@dataclass(frozen=True)
class Relief:
    """Relief of the track in relation to profile `paper`, which measures elevation against the driven ground.

    Ground more than about `paper_band_m` above or below the mean is N regardless of its shape. This has no effect if
    the band `is_spanned`.
    """

    track_span_m: float
    paper_band_m: float
    is_spanned: bool


def relief_of(sequence: Sequence, paper_reference: Reference) -> Relief:
    """Return the relief of the track, given the reference of profile `paper`."""
    z = sequence.frames.map_from_ego.translation_m[:, 2]
    band_m = RELIEF_SIGMAS * float(np.sqrt(paper_reference.covariance[0, 0]))
    return Relief(round(float(np.ptp(z)), 3), round(band_m, 3), band_m > NARROW_BAND_M)


def other_reference(run: LabelRun, tiles: Listing[TileSummary]) -> Reference:
    """Return the reference of the other profile; there is at least one tile."""
    return reference_from(run, list(tiles), other_profile(run.parameters))


@dataclass(frozen=True, eq=False)
class ProfileComparison:
    """`counts` (3, 3): voxels that are T, P, N in the run's own profile (rows) and in the other (columns).

    - `driven`: T voxels; `unlike` of them have a D² above the threshold, so they would be N if not driven
    - `beyond`: T voxels beyond the vehicle's limits
    - `reestimated`: voxels with another class by the alternative estimate of the reference (below)
    - `steep`: steep voxels that were not driven; `steep_p` of them are P, `steep_p_other` by the alternative estimate
    """

    counts: NDArray[np.int64]
    driven: int = 0
    unlike: int = 0
    beyond: int = 0
    reestimated: int = 0
    steep: int = 0
    steep_p: int = 0
    steep_p_other: int = 0

    @property
    def counted(self) -> tuple[int, ...]:
        """Return the single counts, in order."""
        return tuple(getattr(self, name) for name in COUNTED)

    @property
    def reestimated_ratio(self) -> float:
        """The share of the map's voxels with another class by the alternative estimate."""
        return self.reestimated / max(int(self.counts.sum()), 1)

    def as_record(self, parameters: LabelParameters) -> dict[str, Any]:
        """Return the shares of each class in each profile, and of voxels with another class, in the map's voxels."""
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
    """Counts tile by tile."""

    def __init__(self, run: LabelRun, tiles: Listing[TileSummary]) -> None:
        self._run, self._other = run, other_profile(run.parameters)
        self._other_reference = other_reference(run, tiles)
        self._alternative = alternative_reference(run, tiles)
        self.comparison = ProfileComparison(np.zeros((3, 3), np.int64))

    def add(self, tile: LabelledTile) -> None:
        """Add one tile."""
        parameters, vehicle = self._run.parameters, self._run.sequence.calibration.vehicle
        others = self._classes(tile, self._other_reference, self._other)
        bins = np.arange(TRAVERSABLE, NON_TRAVERSABLE + 2) - 0.5
        pairs, _, _ = np.histogram2d(tile.classes, others, (bins, bins))
        again = tile.classes
        if self._alternative is not None:
            again = self._classes(tile, self._alternative, parameters)
        is_steep = ~tile.is_driven & (tile.terrain.slope_deg > vehicle.max_slope_deg + STEEPER_DEG)
        is_beyond = tile.is_driven & (tile.terrain.limit_ratio(vehicle) > 1.0)
        is_unlike = tile.is_driven & (tile.squared > threshold(parameters.reference.alpha))
        steep_p = (is_steep & (classes == POTENTIAL) for classes in (tile.classes, again))
        counted = (tile.is_driven, is_unlike, is_beyond, again != tile.classes, is_steep, *steep_p)
        before = self.comparison
        totals = [old + int(new.sum()) for old, new in zip(before.counted, counted, strict=True)]
        self.comparison = ProfileComparison(before.counts + pairs.astype(np.int64), *totals)

    def _classes(self, tile: LabelledTile, reference: Reference, parameters: LabelParameters) -> NDArray[np.uint8]:
        squared = squared_distances(self._run, tile.terrain, reference, parameters)
        return classify(squared, tile.is_driven, parameters.reference.alpha)


def comparison_path(run: LabelRun) -> Path:
    return run.scratch / COMPARISON


def save_comparison(run: LabelRun, comparison: ProfileComparison) -> None:
    save(comparison_path(run), {"counts": comparison.counts, "counted": np.array(comparison.counted, np.int64)})


def load_comparison(run: LabelRun) -> ProfileComparison:
    arrays = load(comparison_path(run))
    return ProfileComparison(arrays["counts"], *arrays["counted"].tolist())  # type: ignore[arg-type]


def _shares(counts: NDArray[np.int64], total: int) -> dict[str, float]:
    return {name: round(float(n) / total, 6) for name, n in zip(CLASSES, counts, strict=True)}


# Outliers among the driven voxels: the reference without them, by the robust estimate. A voxel is far in a feature if
# it is more than `FAR_SIGMAS` of that estimate from its mean, as is one Gaussian voxel in two million. Both estimates
# are without the floor that a profile adds.


USUAL_RATIO = 0.25
FAR_SIGMAS = 5.0
FEWEST_FAR_RATIO = 0.002
WIDENED_TIMES = 1.5
# In sound drives through worlds with known truth it is at most 3.4 %, and 6.7 % or more in most drives with a LiDAR
# mount entered 10 cm too low (`make bench-outside`).
STEEP_P_RATIO, STEEP_P_TIMES, FEWEST_STEEP = 0.05, 1.5, 100
BEYOND_RATIO = 0.12  # 0.09 in sound drives through tall grass, which exceeds the step limit
NAMES = ("elevation", "slope", "roughness")


@dataclass(frozen=True, eq=False)
class OutlierCounts:
    """Per feature (3,): mean and standard deviation without outliers and of all driven voxels, and outliers.

    The outliers are the number of the `voxels` that are far, and the farthest of them.
    """

    voxels: int
    mean: NDArray[np.float64]
    sigma: NDArray[np.float64]
    sigma_of_all: NDArray[np.float64]
    far: NDArray[np.int64]
    farthest: NDArray[np.float64]

    def as_record(self) -> dict[str, Any]:
        """Return the record by feature name; m, rad, log m²."""
        columns = ("mean", "sigma", "sigma_of_all", "far", "farthest")
        return {name: {column: getattr(self, column)[at].item() for column in columns} for at, name in enumerate(NAMES)}


def outlier_counts(tiles: Listing[TileSummary], parameters: LabelParameters) -> OutlierCounts | None:
    """Return the counts of all tiles, in the profile's own features; None below `FEW_VOXELS` driven voxels."""
    rows = np.concatenate([tile.driven.features(parameters.rule) for tile in tiles])
    if len(rows) < FEW_VOXELS:
        return None
    scatter = robust_scatter(rows, parameters.reference.outlier_ratio or USUAL_RATIO)
    sigma = np.sqrt(np.diag(scatter.covariance))
    off = np.abs(rows - scatter.mean)
    far = (off > FAR_SIGMAS * np.maximum(sigma, np.finfo(float).eps)).sum(axis=0)
    farthest = rows[off.argmax(axis=0), np.arange(rows.shape[1])]
    return OutlierCounts(len(rows), scatter.mean, sigma, rows.std(axis=0, ddof=1), far, farthest)


def alternative_reference(run: LabelRun, tiles: Listing[TileSummary]) -> Reference | None:
    """Return the reference estimated the other way, with or without outliers; None below `FEW_VOXELS`."""
    if sum(len(tile.driven) for tile in tiles) < FEW_VOXELS:
        return None
    given = run.parameters.reference
    other = replace(given, outlier_ratio=0.0, clean_mads=0.0 if given.leaves_out else CLEAN_MADS)
    return reference_from(run, list(tiles), replace(run.parameters, reference=other))


def outlier_findings(
    counts: OutlierCounts | None, parameters: LabelParameters, comparison: ProfileComparison
) -> list[Finding]:
    """Return LAB-606 if outliers among driven voxels widen the reference until it includes too steep ground."""
    if counts is None or parameters.reference.leaves_out:
        return []
    is_wide = counts.sigma_of_all > WIDENED_TIMES * counts.sigma
    spoilt = np.flatnonzero(is_wide & (counts.far > FEWEST_FAR_RATIO * counts.voxels)).tolist()
    if not spoilt or not _is_dangerous(comparison):
        return []
    steep = max(comparison.steep, 1)
    sentence = (
        f"some of the {counts.voxels} driven voxels are outliers: {'; '.join(_far(counts, at) for at in spoilt)}. "
        f"They make {comparison.steep_p / steep:.1%} of the ground too steep for the vehicle potentially traversable; "
        f"without them it is {comparison.steep_p_other / steep:.1%}. Was tall grass driven through, or are surfaces "
        f"beside the ground included? Profile {DEFAULT_PROFILE} excludes such voxels from the reference, which would "
        f"change the class of {comparison.reestimated_ratio:.1%} of the map's voxels"
    )
    return [Finding("LAB-606", "warning", "", sentence)]


def _is_dangerous(comparison: ProfileComparison) -> bool:
    """Return whether outliers make much steep ground P; True if the map has too little steep ground to decide."""
    if comparison.steep < FEWEST_STEEP:
        return True
    more = comparison.steep_p > STEEP_P_TIMES * comparison.steep_p_other
    return more and comparison.steep_p > STEEP_P_RATIO * comparison.steep


def limit_findings(comparison: ProfileComparison) -> list[Finding]:
    """Return LAB-615 if the robot drove over much ground beyond its own limits."""
    ratio = comparison.beyond / max(comparison.driven, 1)
    if comparison.driven < FEW_VOXELS or ratio <= BEYOND_RATIO:
        return []
    sentence = (
        f"{ratio:.1%} of the driven voxels are steeper or rougher than the vehicle's limits allow. Is the LiDAR "
        "mounted as calibrated, are the poses correct, was tall grass driven through, or are the limits too narrow?"
    )
    return [Finding("LAB-615", "warning", "", sentence)]


def _far(counts: OutlierCounts, at: int) -> str:
    """Return one feature's outliers as a phrase."""
    sigma, of_all, farthest = (
        _with_unit(float(values[at]), at) for values in (counts.sigma, counts.sigma_of_all, counts.farthest)
    )
    return f"{counts.far[at]} in {NAMES[at]} (up to {farthest}), with σ {of_all}, or {sigma} without the outliers"


def _with_unit(value: float, at: int) -> str:
    if NAMES[at] == "slope":
        return f"{np.rad2deg(value):.1f}°"
    return f"{value:.2g} m" if NAMES[at] == "elevation" else f"{value:.2g} log m²"
