"""Outliers among the driven voxels: what the reference would be without them, by the robust estimate.

**Conventions.** A voxel is far in a feature when it lies more than `FAR_SIGMAS` of that estimate from its mean, which
one Gaussian voxel in two million does. Both estimates are without the floor that a profile adds.
"""

from collections.abc import Sequence as Listing
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.labeler.map.surface import TileSummary
from services.labeler.parameters import LabelParameters
from services.labeler.results import reference_from
from stone.findings import Finding
from stone.labels.robust_scatter import robust_scatter
from stone.labels.traversability import FEW_VOXELS, Reference, ReferenceParameters

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
