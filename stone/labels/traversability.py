"""Traversability: the driven reference, the distance to it, and the resulting class (paper, IV-C, Eq. 6).

**Conventions.** Classes: 0 free, 1 traversable (T), 2 potentially traversable (P), 3 non-traversable (N). Features are
rows (elevation, slope, roughness). Sums are additive, so parts of a run can be summed separately; they are relative to
`origin`, for precision if the map is high above its datum.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stone.errors import Refused
from stone.labels.robust_scatter import middle_and_spread, robust_scatter

FREE, TRAVERSABLE, POTENTIAL, NON_TRAVERSABLE = 0, 1, 2, 3
FEW_VOXELS = 500
FEWEST_ROBUST = 5
SINGULAR_RATIO = 1e-10

Array = NDArray[np.float64]


def no_reference(voxels: int, needed: int = 4) -> Refused:
    return Refused(
        "no_reference",
        f"the track covers {voxels} surface voxels, but the reference requires at least {needed}: is the ego "
        "origin on the ground, and does the LiDAR see the driven ground?",
    )


@dataclass(frozen=True)
class ReferenceParameters:
    """Parameters of the reference; `alpha` is the paper's 0.05.

    The floor (m, rad, log m²) is added if the covariance is singular. With `floor_voxels` n₀ > 0 (profile `local`), the
    share n₀/(n₀+n) of it is always added, so it fades as the track grows.

    With `clean_mads` > 0, driven voxels farther than this number of scaled median deviations from a feature's median
    are excluded; they stay T. `noise` (m, rad, log m²) is the measurement noise of uniform ground and is always added
    to the covariance. With `outlier_ratio` > 0, mean and covariance are robust (`stone.labels.robust_scatter`): up to
    this share of the driven voxels may be outliers.
    """

    alpha: float = 0.05
    floor: tuple[float, float, float] = (0.3, 0.07, 0.7)
    floor_voxels: int = 0
    outlier_ratio: float = 0.0
    clean_mads: float = 0.0
    noise: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def leaves_out(self) -> bool:
        """Whether atypical driven voxels are excluded."""
        return self.outlier_ratio > 0 or self.clean_mads > 0


@dataclass(frozen=True, eq=False)
class FeatureSums:
    """Σ1, Σ(F−o) (3,) and Σ(F−o)(F−o)ᵀ (3, 3) of the T voxels about `origin` o (3,)."""

    origin: Array
    count: int
    total: Array
    outer: Array


@dataclass(frozen=True, eq=False)
class Reference:
    """The Gaussian of the driven ground: `mean` (3,), `covariance` (3, 3), from `voxels` voxels; `left_out` were
    excluded.
    """

    mean: Array
    covariance: Array
    voxels: int
    is_floored: bool
    left_out: int = 0


def sums_of(features: Array, origin: Array) -> FeatureSums:
    """Return the sums of features (n, 3) about `origin`; n may be 0."""
    centred = features - origin
    return FeatureSums(origin, len(features), centred.sum(axis=0), centred.T @ centred)


def total_of(parts: Sequence[FeatureSums]) -> FeatureSums:
    """Return the total of the parts' sums, which have the same origin."""
    return FeatureSums(
        parts[0].origin,
        sum(part.count for part in parts),
        np.sum([part.total for part in parts], axis=0),
        np.sum([part.outer for part in parts], axis=0),
    )


def reference_of_parts(parts: Sequence[Array], origin: Array, parameters: ReferenceParameters) -> Reference:
    """Return the reference of all parts' features (n, 3) over T, as the parameters require; sums are relative to
    `origin` (3,).

    Raises `no_reference`.
    """
    if parameters.outlier_ratio:
        return robust_reference_of(np.concatenate(parts), parameters)
    if parameters.clean_mads:
        return cleaned_reference_of(np.concatenate(parts), parameters)
    return reference_of(total_of([sums_of(part, origin) for part in parts]), parameters)


def reference_of(sums: FeatureSums, parameters: ReferenceParameters) -> Reference:
    """Return mean and unbiased covariance of F over T. Raises `no_reference` below 4 voxels."""
    if sums.count < 4:
        raise no_reference(sums.count)
    mean = sums.total / sums.count
    covariance = (sums.outer - sums.count * np.outer(mean, mean)) / (sums.count - 1)
    return _floored(sums.origin + mean, covariance, sums.count, parameters)


def robust_reference_of(features: Array, parameters: ReferenceParameters) -> Reference:
    """Return robust mean and covariance of F (n, 3) over T for up to `outlier_ratio` outliers.

    Raises `no_reference` below 5 voxels, because none can be excluded.
    """
    if len(features) < FEWEST_ROBUST:
        raise no_reference(len(features), FEWEST_ROBUST)
    scatter = robust_scatter(features, parameters.outlier_ratio)
    return _floored(scatter.mean, scatter.covariance, len(features), parameters)


def cleaned_reference_of(features: Array, parameters: ReferenceParameters) -> Reference:
    """Return mean and covariance of F (n, 3) over T without values beyond `clean_mads`. Raises `no_reference` below
    4.
    """
    if len(features) < 4:
        raise no_reference(len(features))
    middle, spread = middle_and_spread(features)
    kept = features[(np.abs(features - middle) <= parameters.clean_mads * spread).all(axis=1)]
    reference = reference_of(sums_of(kept, middle), parameters)
    return replace(reference, voxels=len(features), left_out=len(features) - len(kept))


def _floored(mean: Array, covariance: Array, count: int, parameters: ReferenceParameters) -> Reference:
    """Return the reference with the required floor, also if the covariance of `count` voxels is singular."""
    covariance = covariance + np.diag(np.square(parameters.noise))
    floor = np.diag(np.square(parameters.floor))
    if parameters.floor_voxels:
        covariance = covariance + floor * parameters.floor_voxels / (parameters.floor_voxels + count)
    scaled = covariance / np.sqrt(np.outer(np.diag(floor), np.diag(floor)))
    is_singular = bool(np.linalg.eigvalsh(scaled)[0] <= SINGULAR_RATIO)
    if is_singular:
        covariance = covariance + floor
    return Reference(mean, covariance, count, is_singular or parameters.floor_voxels > 0)


def distance_squared(features: Array, reference: Reference) -> Array:
    """Return D² = (F−μ)ᵀ Σ⁻¹ (F−μ), the squared Mahalanobis distance (K,) of features (K, 3) (Eq. 6)."""
    centred = features - reference.mean
    scaled = centred @ np.linalg.inv(reference.covariance)
    return np.asarray(np.einsum("ki,ki->k", scaled, centred), dtype=np.float64)


def threshold(alpha: float) -> float:
    """Return χ²(3, 1−α): the D² that a share α of Gaussian driven ground exceeds."""
    from scipy.special import chdtri  # a lazy import: it takes an eighth of a second

    return float(chdtri(3, alpha))


def classify(squared: Array, is_driven: NDArray[np.bool_], alpha: float) -> NDArray[np.uint8]:
    """Return T for driven voxels, otherwise P if D² ≤ χ²(3, 1−α), otherwise N; (K,) uint8."""
    classes = np.where(squared <= threshold(alpha), POTENTIAL, NON_TRAVERSABLE)
    return np.where(is_driven, TRAVERSABLE, classes).astype(np.uint8)
