"""Variance of a sum of correlated influences, from the slow part of their spectrum, or silence.

    Var(Σ z) ≈ Σ_s n_s · mean of C_j², j = 1 … ν_s,   where the spectrum is flat below ω = π / (6 p), ν_s = ⌊n_s / 6p⌋

The period p must not be shorter than the correlation time, or the variance is too small. So p is the shortest one of
which it can be said with 90 % confidence that the correlation time is no longer: first-order spectra over a noise floor
are fitted to the four octaves *above* ω, and all longer ones must fit clearly worse. What is used and what decides are
different coefficients, nearly independent; so it is not just the lucky narrow intervals that are told. With fewer than
five coefficients nothing is said.

**Conventions.** Series are rows: coefficients (R, K) of `spectra.py`. Frames are the unit of time.

Source: equal-weighted cosine estimator with critical values of t, Müller (2007), Lazarus et al. (2018); spectral
likelihood, Whittle (1953); degrees of freedom of a sum of variances, Satterthwaite (1946).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from stone.scoring.spectra import OCTAVES_ABOVE, STEPS_PER_OCTAVE, Coefficients, SpectrumLayout

FEWEST_USED = 5
FEWEST_DEGREES = 3.0
MOST_UNSEEN_RATIO = 0.2  # frames of sequences too short for a coefficient of their own
FLOORS = (0.0, 0.1, 0.3)  # noise of single frames, as a share of the slow part's density at 0
LONGEST_FITTED = 2.0  # times the period: far longer ones cannot be told from a flat spectrum
SHORTEST_FITTED = 0.25
CLEARLY_WORSE = 0.82  # of log-likelihood: half the 0.8 quantile of χ²(1), 90 % one-sided

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SamplingVariances:
    """Of R series: the variance of their sums, its degrees of freedom, and the correlation time that was allowed for.

    All (R,), NaN where nothing can be said.
    """

    variance: Floats
    degrees: Floats
    correlation_frames: Floats

    @property
    def is_known(self) -> NDArray[np.bool_]:
        return np.isfinite(self.variance)


@dataclass(frozen=True, eq=False)
class _Period:
    """A period that is tried: the coefficients it would use of each sequence, the steps that decide, and the models.

    `inverse` (steps, models) is 1 / density, `log_density` (models,) its sum over coefficients; `is_longer` (models,)
    says whose correlation time is longer than the period.
    """

    period_frames: float
    used: NDArray[np.int64]
    steps: NDArray[np.int64]
    inverse: Floats
    log_density: Floats
    is_longer: NDArray[np.bool_]
    counted: int


def sampling_variances(series: Coefficients, layout: SpectrumLayout) -> SamplingVariances:
    """Of coefficients (R, K). A series without any wander, or that is not finite, is not known."""
    squares = np.asarray(series, np.float64) ** 2
    found = SamplingVariances(*(np.full(len(series), np.nan) for _ in range(3)))
    periods = _periods(layout)
    if not periods:
        return found
    power = _power_by_step(squares, layout)
    undecided = np.isfinite(squares).all(axis=1) & (power.sum(axis=1) > 0)
    for period in periods:
        rows = np.flatnonzero(undecided)
        rows = rows[_is_flat(power[rows], period)]
        _settle(found, rows, squares, (layout, period))
        undecided[rows] = False
    return found


def _settle(
    found: SamplingVariances, rows: NDArray[np.int64], squares: Floats, at: tuple[SpectrumLayout, _Period]
) -> None:
    layout, period = at
    variance, degrees = _variance(squares[rows], layout, period.used)
    is_enough = (degrees >= FEWEST_DEGREES) & (variance > 0)
    for values, of_rows in ((found.variance, variance), (found.degrees, degrees)):
        values[rows] = np.where(is_enough, of_rows, np.nan)
    found.correlation_frames[rows] = np.where(is_enough, period.period_frames, np.nan)


def _variance(squares: Floats, layout: SpectrumLayout, used: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """The variances (R,) and their degrees of freedom; a sequence too short for a coefficient is held to be as all."""
    of_sequence = np.stack(
        [
            squares[:, run.start + 1 : run.start + 1 + count].sum(axis=1)
            for run, count in zip(layout.runs, used, strict=True)
        ],
        axis=1,
    )
    of_all = of_sequence.sum(axis=1, keepdims=True) / used.sum()
    density = np.where(used > 0, of_sequence / np.maximum(used, 1), of_all)
    parts = density * np.asarray(layout.frames_of_sequence)
    variance = parts.sum(axis=1)
    # x²/ν estimates the square of a variance too large by (ν + 2)/ν, whence + 2 and − 2.
    spread = (parts**2 / (used + 2) * (used > 0)).sum(axis=1)
    degrees = np.divide(variance**2, spread, out=np.full_like(variance, 2.0), where=spread > 0) - 2
    return variance, np.clip(degrees, 1, used.sum())


def _is_flat(power: Floats, period: _Period) -> NDArray[np.bool_]:
    """Whether every model with a longer correlation time fits clearly worse than the best one (R,)."""
    power = power[:, period.steps]
    scale = power @ period.inverse / period.counted
    fit = -0.5 * (period.counted * np.log(np.maximum(scale, 1e-300)) + period.log_density)
    longer = fit[:, period.is_longer].max(axis=1)
    return np.asarray(fit.max(axis=1) - longer > CLEARLY_WORSE)


def _power_by_step(squares: Floats, layout: SpectrumLayout) -> Floats:
    """The sums of squares (R, steps) of each step of period, the highest frequencies first."""
    place = layout.steps + OCTAVES_ABOVE * STEPS_PER_OCTAVE
    power = np.zeros((len(squares), _highest_step(layout) + OCTAVES_ABOVE * STEPS_PER_OCTAVE + 1))
    for step in np.unique(place[place >= 0]):
        power[:, step] = squares[:, place == step].sum(axis=1)
    return power


def _highest_step(layout: SpectrumLayout) -> int:
    return int(layout.steps.max())


@lru_cache(64)
def _periods(layout: SpectrumLayout) -> tuple[_Period, ...]:
    """The periods to try, shortest first, while enough coefficients are left."""
    return tuple(_tried(layout))


def _tried(layout: SpectrumLayout) -> Iterator[_Period]:
    frames = np.asarray(layout.frames_of_sequence)
    for step in range(_highest_step(layout) + 1):
        used = layout.used(layout.period_frames(step))
        if used.sum() < FEWEST_USED or frames[used == 0].sum() > MOST_UNSEEN_RATIO * frames.sum():
            return
        yield _period(layout, step, used)


def _period(layout: SpectrumLayout, step: int, used: NDArray[np.int64]) -> _Period:
    above = OCTAVES_ABOVE * STEPS_PER_OCTAVE
    counts = {one: int((layout.steps == one).sum()) for one in range(step - above, step)}
    steps = [one for one, count in counts.items() if count]
    period_frames = layout.period_frames(step)
    times = _fitted_times(period_frames)
    density = np.stack([_density(layout.frequencies[layout.steps == one], times) for one in steps])
    models = np.concatenate([density + floor for floor in FLOORS], axis=1)
    of_step = np.array([counts[one] for one in steps])
    return _Period(
        period_frames,
        used,
        np.array(steps) + above,
        1 / models,
        of_step @ np.log(models),
        np.tile(times > period_frames * (1 + 1e-9), len(FLOORS)),
        int(of_step.sum()),
    )


def _fitted_times(period_frames: float) -> Floats:
    """Correlation times around the period, one frame at the least, and no correlation at all."""
    octaves = np.log2([SHORTEST_FITTED, LONGEST_FITTED])
    steps = np.arange(octaves[0] * STEPS_PER_OCTAVE, octaves[1] * STEPS_PER_OCTAVE + 1) / STEPS_PER_OCTAVE
    times = period_frames * 2.0**steps
    return np.concatenate([[1.0], times[times > 1]])


def _density(frequencies: Floats, times: Floats) -> Floats:
    """The mean density (times,) at these frequencies of first-order processes, 1 at frequency 0."""
    rho = (times - 1) / (times + 1)
    return np.asarray(((1 - rho) ** 2 / (1 - 2 * rho * np.cos(frequencies[:, None]) + rho**2)).mean(axis=0))
