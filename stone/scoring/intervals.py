"""Intervals of scores and of differences of scores, or the reason why nothing is said.

Two questions: *these places*, whether it was luck of the moment on the ground that was driven, from how the influence
of frames wanders inside the sequences (`sampling_variance.py`); and *a new place*, from how whole sequences differ:

    V = Σ_s z_s² / (1 − 2 w_s + Σ w²),   z_s the influence of sequence s, w_s its share of what is counted

Both with critical values of Student's t. Intervals of a ratio are symmetric in its logit, so they stay inside (0, 1).

**Conventions.** Ratios are columns, `stone.scoring.metric.RATIOS`. What is not known is said to be so
(`silences.py`), never shown as a narrow interval or a wide one. Of one submission to one ground truth a `RatioSpectra`
is all that is needed, of two the difference of theirs: the ground that is hard is hard for both.

Source: Student (1908); small-sample variance and degrees of freedom of clusters, Bell and McCaffrey (2002).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.scoring.confusion import Counts
from stone.scoring.influence import CLASS_COLUMNS, MEAN, frame_influences
from stone.scoring.metric import METRIC_VERSION
from stone.scoring.sampling_variance import FEWEST_DEGREES, Floats, sampling_variances
from stone.scoring.silences import FEWEST_SEQUENCES, Scope, Silence
from stone.scoring.spectra import Coefficients, SpectrumLayout, coefficients, layout_of, sums_of_sequences

LEVEL = 0.95
LEAST_SPREAD = 0.5
LEAST_WANDER = 1e-12  # of a ratio: below it is rounding


@dataclass(frozen=True, eq=False)
class RatioSpectra:
    """What is kept of a score to tell its uncertainty and that of its difference from others.

    `coefficients` (K, 5) of the influences; `sequence_weight` (S, 5) the share of each ratio's union that a sequence
    holds; `spread` (5,) the share of the frames over which that union is spread, 1 where all hold as much.
    """

    layout: SpectrumLayout
    coefficients: Coefficients
    sequence_weight: Floats
    spread: Floats

    def minus(self, other: "RatioSpectra") -> "RatioSpectra":
        """Of the difference of two scores. Raises `ShapeError` where their sequences are others."""
        if self.layout != other.layout:
            theirs = other.layout.frames_of_sequence
            raise ShapeError("sequences", (len(theirs),), f"as long as those of the other entry, {theirs[:8]}…")
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
        """Central, symmetric around the value."""
        from scipy.special import stdtrit  # a third of a second, which no process pays at its start

        reach = self.error * float(stdtrit(self.degrees, (1 + level) / 2))
        return self.value - reach, self.value + reach

    def ratio_interval(self, level: float = LEVEL) -> tuple[float, float]:
        """Of a ratio strictly between 0 and 1: central, symmetric in its logit."""
        logit = np.log(self.value / (1 - self.value))
        slope = self.value * (1 - self.value)
        ends = Estimate(logit, self.error / slope, self.degrees).interval(level)
        low, high = (float(1 / (1 + np.exp(-end))) for end in ends)
        return low, high

    @property
    def p(self) -> float:
        """Two-sided, that the true value is 0."""
        from scipy.special import stdtr

        return float(2 * stdtr(self.degrees, -abs(self.value) / self.error))


def ratio_spectra(confusions: Counts, frames_of_sequence: Sequence[int], metric: str = METRIC_VERSION) -> RatioSpectra:
    """Of confusions (F, 4, 4) by frame. Raises `ShapeError` where lengths and frames disagree, `UnknownMetricError`."""
    found, layout = frame_influences(confusions, metric), layout_of(frames_of_sequence)
    kept = coefficients(found.of_frame, layout)
    bounds = np.cumsum([0, *layout.frames_of_sequence])[:-1]
    spread = 1 / (len(found.weight) * (found.weight**2).sum(axis=0))
    spread[MEAN] = spread[list(CLASS_COLUMNS)].min()
    return RatioSpectra(layout, kept, np.add.reduceat(found.weight, bounds, axis=0), spread)


def estimates(values: NDArray[np.floating], spectra: RatioSpectra, scope: Scope) -> tuple[Estimate | Silence, ...]:
    """Of each of the values (5,), ratios or differences of ratios."""
    found = _within(spectra) if scope == "these_places" else _across(spectra)
    silences = _silences(values, spectra, scope)
    return tuple(
        silence or _estimate(float(value), *of_value, scope)
        for value, silence, of_value in zip(values, silences, zip(*found, strict=True), strict=True)
    )


def _estimate(value: float, variance: float, degrees: float, scope: Scope) -> Estimate | Silence:
    if not np.isfinite(variance) or degrees < FEWEST_DEGREES:
        return "few_frames" if scope == "these_places" else "uneven_sequences"
    return Estimate(value, float(np.sqrt(variance)), float(degrees))


def _silences(values: NDArray[np.floating], spectra: RatioSpectra, scope: Scope) -> list[Silence | None]:
    """What is known before anything is estimated."""
    wanders = np.ptp(sums_of_sequences(spectra.coefficients, spectra.layout), axis=0) > LEAST_WANDER
    if scope == "these_places":
        wanders = np.sqrt((spectra.coefficients**2).sum(axis=0)) > LEAST_WANDER
    found: list[Silence | None] = []
    for value, has_wander, spread in zip(values, wanders, spectra.spread, strict=True):
        is_few = scope == "new_place" and len(spectra.layout.frames_of_sequence) < FEWEST_SEQUENCES
        is_concentrated = scope == "these_places" and spread < LEAST_SPREAD
        said: tuple[tuple[bool, Silence], ...] = (
            (not np.isfinite(value), "undefined"),
            (is_few, "few_sequences"),
            (not has_wander, "no_wander"),
            (is_concentrated, "concentrated"),
        )
        found.append(next((code for is_so, code in said if is_so), None))
    return found


def _within(spectra: RatioSpectra) -> tuple[Floats, Floats]:
    found = sampling_variances(spectra.coefficients.T, spectra.layout)
    return found.variance, np.nan_to_num(found.degrees)


def _across(spectra: RatioSpectra) -> tuple[Floats, Floats]:
    """Variances (5,) of the sum of independent sequences, and their degrees of freedom."""
    weight = np.asarray(spectra.sequence_weight, np.float64)
    scale = 1 - 2 * weight + (weight**2).sum(axis=0)
    sums = sums_of_sequences(spectra.coefficients, spectra.layout)
    variance = np.divide(sums**2, scale, out=np.zeros_like(sums), where=scale > 1e-9).sum(axis=0)
    degrees = np.array([_degrees(*one) for one in zip(weight.T, scale.T, strict=True)])
    degrees[MEAN] = degrees[list(CLASS_COLUMNS)].min()
    return variance, degrees


def _degrees(weight: Floats, scale: Floats) -> float:
    """Of V, a quadratic form of sequences' ratios, were these normal and alike: (Σ λ)² / Σ λ² of its eigenvalues."""
    if not np.isfinite(weight).all() or scale.min() <= 1e-9:
        return 0.0
    centred = np.eye(len(weight)) - weight
    form = centred.T @ ((weight**2 / scale)[:, None] * centred)
    return float(np.trace(form) ** 2 / (form**2).sum())
