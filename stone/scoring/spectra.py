"""Slow part of the influences' spectrum: cosine coefficients of each sequence, as many as inference looks at.

    C_j = √(2/n) Σ_t cos(π j (t + ½) / n) z_t,  j ≥ 1;   C_0 = √(1/n) Σ_t z_t

A sequence's C_j are nearly uncorrelated, with the spectral density at ω_j = π j / n as variance. Frequency is told as
a time: `period_frames` p stands for ω = π / (`FRAMES_PER_PERIOD` · p), so a process with correlation time p is nearly
white below its frequency.

**Conventions.** Sequences are contiguous runs of frames in time order, their lengths in `frames_of_sequence`. Of each
the first coefficients are kept, those of all sequences one below another: (K, …). They are linear in z: those of a
difference are the difference of theirs. A correlation time is (1 + ρ) / (1 − ρ) of a first-order process: as many
frames say as much as one that is independent of the others.

Source: discrete cosine transform of type II, Ahmed et al. (1974); its use for variances of means, Müller (2007).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray

from stone.errors import ShapeError

FRAMES_PER_PERIOD = 6.0
MOST_USED = 24  # coefficients from which a variance is estimated: more would narrow an interval by 4 %
STEPS_PER_OCTAVE = 4
OCTAVES_ABOVE = 4  # looked at above those that are used, to tell how far the spectrum is flat

Coefficients = NDArray[np.floating]


@dataclass(frozen=True)
class SpectrumLayout:
    """Which coefficients are kept of sequences of these lengths."""

    frames_of_sequence: tuple[int, ...]

    @property
    def shortest_period_frames(self) -> float:
        """The shortest correlation time that is considered, one frame or more."""
        return max(1.0, sum(self.frames_of_sequence) / (FRAMES_PER_PERIOD * MOST_USED))

    def used(self, period_frames: float) -> NDArray[np.int64]:
        """How many coefficients of each sequence, from j = 1, lie below the frequency of this period (S,)."""
        frames = np.asarray(self.frames_of_sequence, np.int64)
        whole: NDArray[np.int64] = (frames // (FRAMES_PER_PERIOD * period_frames)).astype(np.int64)
        return np.minimum(whole, frames - 1)

    @cached_property
    def kept(self) -> tuple[int, ...]:
        """How many are kept of each sequence, C_0 among them."""
        return tuple((1 + self.used(self.shortest_period_frames / 2**OCTAVES_ABOVE)).tolist())

    @cached_property
    def runs(self) -> tuple[slice, ...]:
        """Where those of each sequence stand."""
        return tuple(slice(*ends) for ends in pairwise(accumulate(self.kept, initial=0)))

    @cached_property
    def steps(self) -> NDArray[np.int64]:
        """The step of period that each kept coefficient lies in (K,), falling with frequency; C_0 in none, −1000."""
        return np.concatenate([self._steps(*of) for of in zip(self.frames_of_sequence, self.kept, strict=True)])

    @cached_property
    def frequencies(self) -> NDArray[np.float64]:
        """ω of each kept coefficient (K,), in radians a frame."""
        lengths = zip(self.frames_of_sequence, self.kept, strict=True)
        return np.concatenate([np.pi * np.arange(kept) / frames for frames, kept in lengths])

    def period_frames(self, step: int) -> float:
        """The period at the lower end of a step's frequencies is that of the next."""
        return float(self.shortest_period_frames * 2.0 ** (step / STEPS_PER_OCTAVE))

    def _steps(self, frames: int, kept: int) -> NDArray[np.int64]:
        numbers = np.arange(1, kept)
        octaves = np.log2(frames / (numbers * FRAMES_PER_PERIOD * self.shortest_period_frames))
        return np.concatenate([[-1000], np.floor(STEPS_PER_OCTAVE * octaves + 1e-9).astype(np.int64)])


def coefficients(influences: NDArray[np.floating], layout: SpectrumLayout) -> NDArray[np.float64]:
    """The kept coefficients (K, …) of influences (F, …). Raises `ShapeError` where lengths and frames disagree."""
    from scipy.fft import dct  # not loaded by who only reads coefficients

    frames = layout.frames_of_sequence
    if len(influences) != sum(frames) or min(frames, default=0) < 1:
        raise ShapeError("influences", influences.shape, f"({sum(frames)}, …), sequences of a frame or more each")
    runs = pairwise(accumulate(frames, initial=0))
    found = (dct(influences[start:stop], type=2, axis=0, norm="ortho") for start, stop in runs)
    return np.concatenate([of_sequence[:kept] for of_sequence, kept in zip(found, layout.kept, strict=True)])


def sums_of_sequences(kept: Coefficients, layout: SpectrumLayout) -> NDArray[np.float64]:
    """The sum of the influences of each sequence (S, …), from C_0 of the kept coefficients (K, …)."""
    first = np.asarray([kept[run.start] for run in layout.runs], np.float64)
    return np.asarray(first * np.sqrt(layout.frames_of_sequence).reshape(-1, *[1] * (first.ndim - 1)))


def layout_of(frames_of_sequence: Sequence[int]) -> SpectrumLayout:
    """Of sequences with so many frames, in their order."""
    return SpectrumLayout(tuple(int(frames) for frames in frames_of_sequence))
