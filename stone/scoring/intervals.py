"""Intervals of scores and of differences of scores, or the reason why there is no interval.

Two scopes. *These places*: the uncertainty on the driven ground, from how the influence of frames varies within the
sequences (`spectra.py`). *New place*: the uncertainty for unseen places, from how whole sequences differ:

    V = Σ_s z_s² / (1 − 2 w_s + Σ w²),   z_s the influence of sequence s, w_s its share of the counted voxels

Sequences that continue each other are one drive and count as one sequence: they share their place, and frames next to a
joint are as correlated as other neighbours.

Both use critical values of Student's t. Intervals of a ratio are symmetric in its logit, so they stay inside (0, 1).

**Conventions.** Ratios are columns, `stone.scoring.metric.RATIOS`. An unknown interval is reported as unknown with a
reason, never as a narrow or wide interval. A `RatioSpectra` contains all that is needed for one submission and ground
truth. For two submissions, use the difference of their spectra, because difficult ground is difficult for both.

Source: Student (1908); small-sample variance and degrees of freedom of clusters, Bell and McCaffrey (2002).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.scoring.confusion import Counts, unions_and_hits
from stone.scoring.metric import METRIC_VERSION, RATIOS
from stone.scoring.spectra import (
    FEWEST_DEGREES,
    Coefficients,
    Floats,
    SpectrumLayout,
    coefficients,
    layout_of,
    sampling_variances,
    sums_of_sequences,
)
from stone.scoring.student import critical_value, two_sided

# Influence of each frame on a ratio of sums, to first order: z_f = ∇g(C) · c_f with r = g(C), C = Σ_f c_f. Their sum is
# 0, because a ratio does not change if all counts grow by the same factor. The variation of z along a sequence is the
# ratio's uncertainty. Confusion matrices are (F, 4, 4) by frame; influences (F, 5) float64, columns
# `stone.scoring.metric.RATIOS`, NaN if the ratio is undefined. For a − b they are z_a − z_b. Source: the influence
# function, Hampel (1974); as the linearisation of a ratio estimator, Woodruff (1971).


OCCUPIED, MEAN = RATIOS.index("iou_occ"), RATIOS.index("miou")
CLASS_COLUMNS = tuple(RATIOS.index(name) for name in ("iou_t", "iou_p", "iou_n"))

Influences = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FrameInfluences:
    """`of_frame` (F, 5) the influences; `weight` (F, 5) ≥ 0 each frame's share of the ratio's union."""

    of_frame: Influences
    weight: Influences


def frame_influences(confusions: Counts, metric: str = METRIC_VERSION) -> FrameInfluences:
    """Return each frame's influence on the scores, from confusion matrices (F, 4, 4).

    Raises `ShapeError` for another shape or no frame, and `unknown_metric`.
    """
    if confusions.ndim != 3 or not len(confusions):
        raise ShapeError("confusions", confusions.shape, "(F, 4, 4) with at least one frame")
    unions, hits = (counts.astype(np.float64) for counts in unions_and_hits(confusions, metric))
    union, hit = unions.sum(axis=0), hits.sum(axis=0)
    whole = np.where(union > 0, union, np.nan)
    of_frame, weight = (hits - unions * (hit / whole)) / whole, unions / whole
    return FrameInfluences(_with_mean(of_frame), _with_mean(weight))


def _with_mean(of_parts: Influences) -> Influences:
    """Return influences (F, 5) from those of occupancy and the three classes (F, 4); the mean's is the mean of its
    classes'.
    """
    columns = np.empty((len(of_parts), len(RATIOS)))
    columns[:, [OCCUPIED, *CLASS_COLUMNS]] = of_parts
    columns[:, MEAN] = of_parts[:, 1:].mean(axis=1)
    return columns


# Reasons for missing intervals of a score or a difference of scores. A reason is a code; its sentence completes a
# phrase such as "No interval:". This module loads nothing, so every process may import it.


Scope = Literal["these_places", "new_place"]
Silence = Literal[
    "undefined",
    "no_wander",
    "few_frames",
    "concentrated",
    "few_sequences",
    "uneven_sequences",
    "unknown_order",
    "withdrawn",
]

SCOPES: tuple[Scope, ...] = get_args(Scope)
FEWEST_SEQUENCES = 5
UNKNOWN_ORDER: Silence = "unknown_order"
WITHDRAWN: Silence = "withdrawn"
SILENCES: Mapping[Silence, str] = {
    "undefined": "it is undefined",
    "no_wander": "it does not vary between frames, so its uncertainty cannot be estimated",
    "few_frames": "too few independent frames (neighbouring frames are correlated)",
    "concentrated": "most of the counted voxels lie in a few frames",
    "few_sequences": f"at least {FEWEST_SEQUENCES} sequences that do not continue each other are required",
    "uneven_sequences": "a few sequences contain most of the counted voxels",
    "unknown_order": "the time order of frames is unknown, and so is the correlation of neighbouring frames",
    "withdrawn": "the intervals of this metric version were too narrow and have been withdrawn",
}


LEVEL = 0.95
LEAST_SPREAD = 0.5
LEAST_WANDER = 1e-12  # a smaller variation of a ratio is rounding


@dataclass(frozen=True, eq=False)
class RatioSpectra:
    """Data for the uncertainty of a score, and of its difference from other scores.

    `coefficients` (K, 5) are those of the influences. `sequence_weight` (S, 5) is each sequence's share of each ratio's
    union. `spread` (5,) is the share of frames over which that union is spread, 1 if all frames have the same weight.
    """

    layout: SpectrumLayout
    coefficients: Coefficients
    sequence_weight: Floats
    spread: Floats

    def minus(self, other: "RatioSpectra") -> "RatioSpectra":
        """Return the spectra of the difference of two scores. Raises `ShapeError` if their sequences differ."""
        if self.layout != other.layout:
            theirs = other.layout.frames_of_sequence
            raise ShapeError("sequences", (len(theirs),), f"as long as the other entry's, {theirs[:8]}…")
        weight = (self.sequence_weight + other.sequence_weight) / 2
        spread = np.minimum(self.spread, other.spread)
        return RatioSpectra(self.layout, self.coefficients - other.coefficients, weight, spread)


@dataclass(frozen=True)
class Estimate:
    """The standard error of a value and its degrees of freedom."""

    value: float
    error: float
    degrees: float

    def interval(self, level: float = LEVEL) -> tuple[float, float]:
        """Return the central interval, symmetric around the value."""
        reach = self.error * critical_value(level, self.degrees)
        return self.value - reach, self.value + reach

    def ratio_interval(self, level: float = LEVEL) -> tuple[float, float]:
        """Return the central interval of a ratio strictly between 0 and 1, symmetric in its logit."""
        logit = np.log(self.value / (1 - self.value))
        slope = self.value * (1 - self.value)
        ends = Estimate(logit, self.error / slope, self.degrees).interval(level)
        low, high = (float(1 / (1 + np.exp(-end))) for end in ends)
        return low, high

    @property
    def p(self) -> float:
        """The two-sided p-value of the hypothesis that the true value is 0."""
        return two_sided(self.value / self.error, self.degrees)


def ratio_spectra(confusions: Counts, frames_of_sequence: Sequence[int], metric: str = METRIC_VERSION) -> RatioSpectra:
    """Return the spectra of the scores, from confusion matrices (F, 4, 4).

    Raises `ShapeError` if the lengths do not add up to F, and `unknown_metric`.
    """
    influences, layout = frame_influences(confusions, metric), layout_of(frames_of_sequence)
    kept = coefficients(influences.of_frame, layout)
    bounds = np.cumsum([0, *layout.frames_of_sequence])[:-1]
    spread = 1 / (len(influences.weight) * (influences.weight**2).sum(axis=0))
    spread[MEAN] = spread[list(CLASS_COLUMNS)].min()
    return RatioSpectra(layout, kept, np.add.reduceat(influences.weight, bounds, axis=0), spread)


def estimates(values: NDArray[np.floating], spectra: RatioSpectra, scope: Scope) -> tuple[Estimate | Silence, ...]:
    """Return the estimate, or the reason for its absence, of each of the values (5,): ratios or differences of
    ratios.
    """
    variances = _within(spectra) if scope == "these_places" else _across(spectra)
    silences = _silences(values, spectra, scope)
    return tuple(
        silence or _estimate(float(value), *of_value, scope)
        for value, silence, of_value in zip(values, silences, zip(*variances, strict=True), strict=True)
    )


def _estimate(value: float, variance: float, degrees: float, scope: Scope) -> Estimate | Silence:
    if not np.isfinite(variance) or degrees < FEWEST_DEGREES:
        return "few_frames" if scope == "these_places" else "uneven_sequences"
    return Estimate(value, float(np.sqrt(variance)), float(degrees))


def _silences(values: NDArray[np.floating], spectra: RatioSpectra, scope: Scope) -> list[Silence | None]:
    """Return the reasons that are known before any estimation."""
    wanders = np.ptp(sums_of_sequences(spectra.coefficients, spectra.layout), axis=0) > LEAST_WANDER
    if scope == "these_places":
        wanders = np.sqrt((spectra.coefficients**2).sum(axis=0)) > LEAST_WANDER
    silences: list[Silence | None] = []
    for value, has_wander, spread in zip(values, wanders, spectra.spread, strict=True):
        is_few = scope == "new_place" and len(spectra.layout.frames_of_sequence) < FEWEST_SEQUENCES
        is_concentrated = scope == "these_places" and spread < LEAST_SPREAD
        conditions: tuple[tuple[bool, Silence], ...] = (
            (not np.isfinite(value), "undefined"),
            (is_few, "few_sequences"),
            (not has_wander, "no_wander"),
            (is_concentrated, "concentrated"),
        )
        silences.append(next((code for is_so, code in conditions if is_so), None))
    return silences


def _within(spectra: RatioSpectra) -> tuple[Floats, Floats]:
    variances = sampling_variances(spectra.coefficients.T, spectra.layout)
    return variances.variance, np.nan_to_num(variances.degrees)


def _across(spectra: RatioSpectra) -> tuple[Floats, Floats]:
    sums = sums_of_sequences(spectra.coefficients, spectra.layout)
    return across_variance(sums, spectra.sequence_weight), across_degrees(spectra)


def across_variance(sums: Floats, sequence_weight: NDArray[np.floating]) -> Floats:
    """Return the variance V (…) of the sum of independent sequences, from their sums and weights (S, …)."""
    weight = np.asarray(sequence_weight, np.float64)
    scale = 1 - 2 * weight + (weight**2).sum(axis=0)
    return np.asarray(np.divide(sums**2, scale, out=np.zeros_like(sums), where=scale > 1e-9).sum(axis=0))


def across_degrees(spectra: RatioSpectra) -> Floats:
    """Return the degrees of freedom (5,) of V; for the mean, the fewest of its classes."""
    degrees = np.array([_degrees(weight) for weight in np.asarray(spectra.sequence_weight, np.float64).T])
    degrees[MEAN] = degrees[list(CLASS_COLUMNS)].min()
    return degrees


def _degrees(weight: Floats) -> float:
    """Return (Σ λ)² / Σ λ² of the eigenvalues λ of V, a quadratic form of sequence ratios assumed normal and
    identical.
    """
    scale = 1 - 2 * weight + (weight**2).sum()
    if not np.isfinite(weight).all() or scale.min() <= 1e-9:
        return 0.0
    centred = np.eye(len(weight)) - weight
    form = centred.T @ ((weight**2 / scale)[:, None] * centred)
    return float(np.trace(form) ** 2 / (form**2).sum())
