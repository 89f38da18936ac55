"""Low-frequency part of the influences' spectrum: the cosine coefficients of each sequence that inference uses.

    C_j = √(2/n) Σ_t cos(π j (t + ½) / n) z_t,  j ≥ 1;   C_0 = √(1/n) Σ_t z_t

A sequence's C_j are nearly uncorrelated, with the spectral density at ω_j = π j / n as variance. Frequency is expressed
as a time: `period_frames` p stands for ω = π / (`FRAMES_PER_PERIOD` · p), so a process with correlation time p is
nearly white below this frequency.

**Conventions.** Sequences are contiguous runs of frames in time order, with lengths `frames_of_sequence`. The first
coefficients of each are kept, stacked over all sequences: (K, …). They are linear in z, so the coefficients of a
difference are the difference of coefficients. A correlation time is (1 + ρ) / (1 − ρ) of a first-order process: this
many frames contain as much information as one independent frame.

Source: discrete cosine transform of type II, Ahmed et al. (1974); its use for variances of means, Müller (2007).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import accumulate, pairwise
from math import gamma

import numpy as np
from numpy.typing import NDArray

from stone.errors import ShapeError

FRAMES_PER_PERIOD = 6.0
MOST_USED = 24  # coefficients for a variance: more would narrow an interval by 4 %
STEPS_PER_OCTAVE = 4
OCTAVES_ABOVE = 4  # above the used ones, to test how far the spectrum is flat

Coefficients = NDArray[np.floating]


@dataclass(frozen=True)
class SpectrumLayout:
    """The coefficients kept for sequences of these lengths."""

    frames_of_sequence: tuple[int, ...]

    @property
    def shortest_period_frames(self) -> float:
        """The shortest correlation time that is considered, at least one frame."""
        return max(1.0, sum(self.frames_of_sequence) / (FRAMES_PER_PERIOD * MOST_USED))

    def used(self, period_frames: float) -> NDArray[np.int64]:
        """Return the number (S,) of coefficients of each sequence, from j = 1, below the frequency of this period."""
        frames = np.asarray(self.frames_of_sequence, np.int64)
        whole: NDArray[np.int64] = (frames // (FRAMES_PER_PERIOD * period_frames)).astype(np.int64)
        return np.minimum(whole, frames - 1)

    @cached_property
    def kept(self) -> tuple[int, ...]:
        """The number of kept coefficients of each sequence, including C_0."""
        return tuple((1 + self.used(self.shortest_period_frames / 2**OCTAVES_ABOVE)).tolist())

    @cached_property
    def runs(self) -> tuple[slice, ...]:
        """The slice of each sequence's coefficients."""
        return tuple(slice(*ends) for ends in pairwise(accumulate(self.kept, initial=0)))

    @cached_property
    def steps(self) -> NDArray[np.int64]:
        """The period step (K,) of each kept coefficient, decreasing with frequency; −1000 for C_0, which has none."""
        return np.concatenate([self._steps(*of) for of in zip(self.frames_of_sequence, self.kept, strict=True)])

    @cached_property
    def frequencies(self) -> NDArray[np.float64]:
        """The frequency ω (K,) of each kept coefficient, in radians per frame."""
        lengths = zip(self.frames_of_sequence, self.kept, strict=True)
        return np.concatenate([np.pi * np.arange(kept) / frames for frames, kept in lengths])

    def period_frames(self, step: int) -> float:
        """Return the period at the lower end of a step's frequencies, which is the next step's period."""
        return float(self.shortest_period_frames * 2.0 ** (step / STEPS_PER_OCTAVE))

    def _steps(self, frames: int, kept: int) -> NDArray[np.int64]:
        numbers = np.arange(1, kept)
        octaves = np.log2(frames / (numbers * FRAMES_PER_PERIOD * self.shortest_period_frames))
        return np.concatenate([[-1000], np.floor(STEPS_PER_OCTAVE * octaves + 1e-9).astype(np.int64)])


def coefficients(influences: NDArray[np.floating], layout: SpectrumLayout) -> NDArray[np.float64]:
    """Return the kept coefficients (K, …) of influences (F, …). Raises `ShapeError` if lengths and frames disagree."""
    frames = layout.frames_of_sequence
    if len(influences) != sum(frames) or min(frames, default=0) < 1:
        raise ShapeError("influences", influences.shape, f"({sum(frames)}, …), sequences of at least one frame each")
    runs = pairwise(accumulate(frames, initial=0))
    transforms = (_cosine_transform(influences[start:stop]) for start, stop in runs)
    return np.concatenate([of_sequence[:kept] for of_sequence, kept in zip(transforms, layout.kept, strict=True)])


def _cosine_transform(signal: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the orthonormal type II transform along the first axis, by an FFT of the same length (Makhoul 1980)."""
    frames = len(signal)
    turns = np.exp(-0.5j * np.pi * np.arange(frames) / frames).reshape(-1, *[1] * (signal.ndim - 1))
    transformed = (np.fft.fft(np.concatenate([signal[::2], signal[1::2][::-1]]), axis=0) * turns).real
    transformed *= np.sqrt(2 / frames)
    transformed[0] *= np.sqrt(0.5)
    return np.asarray(transformed, np.float64)


def sums_of_sequences(kept: Coefficients, layout: SpectrumLayout) -> NDArray[np.float64]:
    """Return the sum of the influences of each sequence (S, …), from C_0 of the kept coefficients (K, …)."""
    first = np.asarray([kept[run.start] for run in layout.runs], np.float64)
    return np.asarray(first * np.sqrt(layout.frames_of_sequence).reshape(-1, *[1] * (first.ndim - 1)))


def layout_of(frames_of_sequence: Sequence[int]) -> SpectrumLayout:
    """Return the layout of sequences with these numbers of frames."""
    return SpectrumLayout(tuple(int(frames) for frames in frames_of_sequence))


# Variance of a sum of correlated influences, from the low-frequency part of their spectrum, or no result. Var(Σ z) ≈
# Σ_s n_s · mean of C_j², j = 1 … ν_s, if the spectrum is flat below ω = π / (6 p), with ν_s = ⌊n_s / 6p⌋. The period p
# must not be shorter than the correlation time, or the variance is too small. So p is the shortest period that the
# correlation time does not exceed with 90 % confidence. First-order spectra over a noise floor are fitted to the four
# octaves *above* ω; all longer correlation times must fit clearly worse. The variance and this decision use different,
# nearly independent coefficients, so that narrow intervals are not selected by chance. Fewer than five coefficients
# give no result. Long memory (a spectrum that rises as a power law down to frequency 0) resembles a long correlation
# time over a noise floor. Power laws S_d(ω) ∝ ω^−2d are therefore fitted too, to the used coefficients and those above.
# The variance is the mean over both kinds of process, weighted by likelihood: (P(short) · Var_short + Σ_d P(d) · Var_d)
# / (P(short) + Σ_d P(d)). Var_d(Σ z) is S_d(1) · Σ_s n_s^(1 + 2d) / (Γ(2 + 2d) cos πd). Intervals are wider according
# to the likelihood of long memory, and are given as often as without it. Series are rows: coefficients (R, K) of
# `spectra.py`. Frames are the unit of time. Sources. Equal-weighted cosine estimator with critical values of t: Müller
# (2007), Lazarus et al. (2018). Spectral likelihood: Whittle (1953). Degrees of freedom of a sum of variances:
# Satterthwaite (1946). Fractional Gaussian noise, H = d + 1/2: Mandelbrot and Van Ness (1968). Mean over models by
# likelihood: Leamer (1978).


FEWEST_USED = 5
FEWEST_DEGREES = 3.0
MOST_UNSEEN_RATIO = 0.2  # frames of sequences too short for a coefficient of their own
FLOORS = (0.0, 0.1, 0.3)  # noise of single frames, as a share of the slow part's density at 0
LONGEST_FITTED = 2.0  # times the period: much longer times are indistinguishable from a flat spectrum
SHORTEST_FITTED = 0.25
CLEARLY_WORSE = 0.82  # difference of log-likelihood: half the 0.8 quantile of χ²(1), 90 % one-sided
MEMORIES = np.array([0.2, 0.3, 0.4, 0.45])  # d of the power laws
LONG_MEMORY_ODDS = 10.0  # prior odds, chosen so that intervals hold at H = 0.9

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SamplingVariances:
    """For R series: the variance of their sums, its degrees of freedom, and the assumed correlation time.

    All (R,), NaN if there is no result.
    """

    variance: Floats
    degrees: Floats
    correlation_frames: Floats

    @property
    def is_known(self) -> NDArray[np.bool_]:
        return np.isfinite(self.variance)


@dataclass(frozen=True, eq=False)
class _Models:
    """Spectra up to a scale, at `counted` coefficients in groups.

    `inverse` (groups, models) is 1 / density, `log_density` (models,) its sum over coefficients.
    """

    inverse: Floats
    log_density: Floats
    counted: int

    def fit(self, power: Floats) -> tuple[Floats, Floats]:
        """Return the scales of largest likelihood and its logarithm (R, models), from sums of squares (R, groups)."""
        scale = np.maximum(power @ self.inverse / self.counted, 1e-300)
        return scale, -0.5 * (self.counted * np.log(scale) + self.log_density)


@dataclass(frozen=True, eq=False)
class _Period:
    """A candidate period: the coefficients it would use of each sequence, the steps that decide, and the models.

    `places` are the positions of the used coefficients. `above` are models at the steps only, `short` and `long` also
    at the used coefficients. `is_longer` marks each short model with a correlation time longer than the period;
    `long_variance` is the variance of the sum for each long model of scale 1.
    """

    period_frames: float
    used: NDArray[np.int64]
    places: NDArray[np.int64]
    steps: NDArray[np.int64]
    above: _Models
    short: _Models
    long: _Models
    is_longer: NDArray[np.bool_]
    long_variance: Floats


def sampling_variances(series: Coefficients, layout: SpectrumLayout) -> SamplingVariances:
    """Return the variances for coefficients (R, K). A constant or non-finite series has no result."""
    squares = np.asarray(series, np.float64) ** 2
    variances = SamplingVariances(*(np.full(len(series), np.nan) for _ in range(3)))
    periods = _periods(layout)
    if not periods:
        return variances
    power = _power_by_step(squares, layout)
    undecided = np.isfinite(squares).all(axis=1) & (power.sum(axis=1) > 0)
    for period in periods:
        rows = np.flatnonzero(undecided)
        rows = rows[_is_flat(power[rows], period)]
        _settle(variances, rows, (squares, power), (layout, period))
        undecided[rows] = False
    return variances


def _settle(
    variances: SamplingVariances, rows: NDArray[np.int64], of: tuple[Floats, Floats], at: tuple[SpectrumLayout, _Period]
) -> None:
    (squares, power), (layout, period) = (table[rows] for table in of), at
    variance, degrees = _variance(squares, layout, period.used)
    variance = _with_long_memory(variance, np.hstack([power[:, period.steps], squares[:, period.places]]), period)
    is_enough = (degrees >= FEWEST_DEGREES) & (variance > 0)
    for values, of_rows in ((variances.variance, variance), (variances.degrees, degrees)):
        values[rows] = np.where(is_enough, of_rows, np.nan)
    variances.correlation_frames[rows] = np.where(is_enough, period.period_frames, np.nan)


def _variance(squares: Floats, layout: SpectrumLayout, used: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Return the variances (R,) and their degrees of freedom; a sequence too short for a coefficient uses the overall
    mean.
    """
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
    # x²/ν overestimates the square of a variance by (ν + 2)/ν, hence + 2 and − 2.
    spread = (parts**2 / (used + 2) * (used > 0)).sum(axis=1)
    degrees = np.divide(variance**2, spread, out=np.full_like(variance, 2.0), where=spread > 0) - 2
    return variance, np.clip(degrees, 1, used.sum())


def _is_flat(power: Floats, period: _Period) -> NDArray[np.bool_]:
    """Return whether every model with a longer correlation time fits clearly worse than the best one (R,)."""
    _, fit = period.above.fit(power[:, period.steps])
    longer = fit[:, period.is_longer].max(axis=1)
    return np.asarray(fit.max(axis=1) - longer > CLEARLY_WORSE)


def _with_long_memory(variance: Floats, power: Floats, period: _Period) -> Floats:
    """Return the mean (R,) of this variance and the power laws' variances, weighted by likelihood."""
    _, short = period.short.fit(power)
    scale, long = period.long.fit(power)
    best = np.maximum(short.max(axis=1), long.max(axis=1))[:, None]
    of_short = np.exp(short - best).mean(axis=1)
    of_long = LONG_MEMORY_ODDS * np.exp(long - best) / long.shape[1]
    sums = of_short * variance + (of_long * scale) @ period.long_variance
    return np.asarray(sums / (of_short + of_long.sum(axis=1)))


def _power_by_step(squares: Floats, layout: SpectrumLayout) -> Floats:
    """Return the sums of squares (R, steps) of each period step, the highest frequencies first."""
    step_index = layout.steps + OCTAVES_ABOVE * STEPS_PER_OCTAVE
    power = np.zeros((len(squares), _highest_step(layout) + OCTAVES_ABOVE * STEPS_PER_OCTAVE + 1))
    for step in np.unique(step_index[step_index >= 0]):
        power[:, step] = squares[:, step_index == step].sum(axis=1)
    return power


def _highest_step(layout: SpectrumLayout) -> int:
    return int(layout.steps.max())


@lru_cache(64)
def _periods(layout: SpectrumLayout) -> tuple[_Period, ...]:
    """Return the candidate periods, shortest first, that leave enough coefficients."""
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
    places = np.concatenate([np.arange(1, 1 + count) + run.start for run, count in zip(layout.runs, used, strict=True)])
    of_step = [(number, np.flatnonzero(layout.steps == number)) for number in range(step - above, step)]
    steps = np.array([number for number, members in of_step if len(members)])
    decisive = [layout.frequencies[members] for _, members in of_step if len(members)]
    single = [layout.frequencies[[index]] for index in places]
    period_frames = layout.period_frames(step)
    times = _fitted_times(period_frames)
    lowest = np.pi / (FRAMES_PER_PERIOD * period_frames)

    def first_order(frequencies: Floats) -> Floats:
        return _density(frequencies, times)

    def power_law(frequencies: Floats) -> Floats:
        return np.asarray(((frequencies[:, None] / lowest) ** (-2 * MEMORIES)).mean(axis=0))

    return _Period(
        period_frames,
        used,
        places,
        steps + above,
        _models(decisive, first_order),
        _models(decisive + single, first_order),
        _models(decisive + single, power_law),
        np.tile(times > period_frames * (1 + 1e-9), len(FLOORS)),
        _long_variance(np.asarray(layout.frames_of_sequence), lowest),
    )


def _models(groups: Sequence[Floats], density: Callable[[Floats], Floats]) -> _Models:
    """Return the models with this mean density in each group of frequencies, over each of the floors."""
    bare = np.stack([density(frequencies) for frequencies in groups])
    whole = np.concatenate([bare + floor for floor in FLOORS], axis=1)
    counts = np.array([len(frequencies) for frequencies in groups])
    return _Models(1 / whole, counts @ np.log(whole), int(counts.sum()))


def _long_variance(frames: NDArray[np.int64], lowest: float) -> Floats:
    """Return the variance of the sum for each power law, scaled to 1 at the lowest of these frequencies, over each
    floor.
    """
    gammas = np.array([gamma(2 + 2 * memory) for memory in MEMORIES.tolist()])
    at_zero = (frames[:, None] * lowest) ** (2 * MEMORIES) / (gammas * np.cos(np.pi * MEMORIES))
    return np.concatenate([frames @ (at_zero + floor) for floor in FLOORS])


def _fitted_times(period_frames: float) -> Floats:
    """Return correlation times around the period, at least one frame, and no correlation."""
    octaves = np.log2([SHORTEST_FITTED, LONGEST_FITTED])
    steps = np.arange(octaves[0] * STEPS_PER_OCTAVE, octaves[1] * STEPS_PER_OCTAVE + 1) / STEPS_PER_OCTAVE
    times = period_frames * 2.0**steps
    return np.concatenate([[1.0], times[times > 1]])


def _density(frequencies: Floats, times: Floats) -> Floats:
    """Return the mean density (times,) of first-order processes at these frequencies, scaled to 1 at frequency 0."""
    rho = (times - 1) / (times + 1)
    return np.asarray(((1 - rho) ** 2 / (1 - 2 * rho * np.cos(frequencies[:, None]) + rho**2)).mean(axis=0))
