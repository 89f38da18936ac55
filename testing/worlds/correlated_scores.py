"""Worlds of correlated frames whose true scores are known in closed form.

**Conventions.** In frame t of a sequence, class c has N voxels; an entry predicts a share h of these correctly:

    log N = log m_c + 0.3 x − 0.045,   logit h = 0.4 + δ_s + δ'_s + 0.25 y + 0.25 y'

The processes x, y, y' are stationary with mean 0 and variance 1, independent for every class. All entries share y and
the place's δ; each entry has its own y' and δ'. So entries are equally good, and hard ground is hard for all. Half of
the missed voxels are predicted free, half as the next class. Size and quality are independent, so the truth follows
from E N = m_c and E h, a Gauss–Hermite sum. The code follows the definition of the scores and imports nothing of the
platform.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.special import expit

Kind = Literal["first_order", "window", "regimes", "fractional"]
Floats = NDArray[np.float64]

VOXELS = np.array([900.0, 600.0, 1500.0])
SIZE_WANDER, SHARED_WANDER, OWN_WANDER, BASE = 0.3, 0.25, 0.25, 0.4


@dataclass(frozen=True)
class CorrelatedWorld:
    """Sequences of these lengths; `place` and `own_place` are the spread of δ and δ'.

    `memory` is the parameter of the process. For `first_order` it is the correlation ρ from frame to frame; for
    `window` the number of frames of a moving average over white ground, beyond which the correlation is 0. For
    `regimes` it is the mean length in frames of stretches of one value, geometric; for `fractional` Gaussian noise its
    Hurst exponent H, above 0.5 correlated over all times. `noise` is the share of variance that is noise of single
    frames.
    """

    frames_of_sequence: tuple[int, ...]
    memory: float
    kind: Kind = "first_order"
    noise: float = 0.0
    place: float = 0.3
    own_place: float = 0.1


@dataclass(frozen=True, eq=False)
class CorrelatedTrial:
    """A season in that world: confusions of each entry (F, 4, 4), its true mIoU on this ground."""

    confusions: tuple[NDArray[np.int64], ...]
    true_here: tuple[float, ...]


def trial(world: CorrelatedWorld, random: np.random.Generator, entries: int = 2) -> CorrelatedTrial:
    """Draw a season of equally good entries."""
    places = world.place * random.standard_normal(len(world.frames_of_sequence))
    own = world.own_place * random.standard_normal((entries, len(places)))
    counts: list[list[NDArray[np.int64]]] = [[] for _ in range(entries)]
    for sequence, frames in enumerate(world.frames_of_sequence):
        size = VOXELS[:, None] * np.exp(SIZE_WANDER * _wander(world, random, frames) - SIZE_WANDER**2 / 2)
        ground = SHARED_WANDER * _wander(world, random, frames) + BASE + places[sequence]
        for entry in range(entries):
            quality = expit(ground + own[entry, sequence] + OWN_WANDER * _wander(world, random, frames))
            counts[entry].append(_confusions(np.rint(size), quality))
    truths = tuple(true_miou(world.frames_of_sequence, places + own_places) for own_places in own)
    return CorrelatedTrial(tuple(np.concatenate(of_entry) for of_entry in counts), truths)


def true_miou(weights: Sequence[float], offsets: Floats, spread: float = 0.0) -> float:
    """Return the true mIoU of places with these offsets, weighted; `spread` is that of unknown places."""
    right = np.array([_expected_share(float(offset), spread) for offset in offsets])
    share = float(np.average(right, weights=np.asarray(weights, np.float64)))
    hits, misses = VOXELS * share, VOXELS * (1 - share)
    unions = VOXELS + np.roll(misses, 1) / 2
    return float(np.mean(hits / unions))


@lru_cache(4096)
def _expected_share(offset: float, spread: float) -> float:
    """Return E h over y, y' and the unknown part of the place, all normal."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(80)
    deviation = np.sqrt(SHARED_WANDER**2 + OWN_WANDER**2 + spread**2)
    return float(weights @ expit(BASE + offset + deviation * nodes) / weights.sum())


def _confusions(size: Floats, share: Floats) -> NDArray[np.int64]:
    """Return (F, 4, 4) from voxels and shares (3, F)."""
    hits = np.rint(size * share)
    wrong = np.floor((size - hits) / 2)
    counts = np.zeros((size.shape[1], 4, 4), np.int64)
    for of_class in range(3):
        row = counts[:, 1 + of_class]
        row[:, 1 + of_class] = hits[of_class]
        row[:, 1 + (of_class + 1) % 3] = wrong[of_class]
        row[:, 0] = size[of_class] - hits[of_class] - wrong[of_class]
    return counts


def _wander(world: CorrelatedWorld, random: np.random.Generator, frames: int) -> Floats:
    """Draw (3, F) of mean 0 and variance 1, one row for each class."""
    slow = PROCESSES[world.kind](world.memory, random, frames)
    if not world.noise:
        return slow
    noise = random.standard_normal((3, frames))
    return np.asarray(np.sqrt(1 - world.noise) * slow + np.sqrt(world.noise) * noise, np.float64)


def _first_order(rho: float, random: np.random.Generator, frames: int) -> Floats:
    drive = random.standard_normal((3, frames))
    drive[:, 1:] *= np.sqrt(1 - rho**2)
    return np.asarray(lfilter([1.0], [1.0, -rho], drive, axis=1), np.float64)


def _window(length_frames: float, random: np.random.Generator, frames: int) -> Floats:
    length = max(1, round(length_frames))
    sums = np.cumsum(random.standard_normal((3, frames + length)), axis=1)
    return np.asarray((sums[:, length:] - sums[:, :-length]) / np.sqrt(length), np.float64)


def _regimes(mean_frames: float, random: np.random.Generator, frames: int) -> Floats:
    begins = random.random((3, frames)) < 1 / mean_frames
    regime = np.cumsum(begins, axis=1, dtype=np.int64)
    return np.take_along_axis(random.standard_normal((3, frames + 1)), regime, axis=1)


def fractional(hurst: float, random: np.random.Generator, frames: int) -> Floats:
    """Draw exactly by circulant embedding of the covariance (|k + 1|²ᴴ − 2 |k|²ᴴ + |k − 1|²ᴴ) / 2.

    Source: Davies and Harte (1987).
    """
    lags = np.minimum(np.arange(2 * frames), 2 * frames - np.arange(2 * frames))
    powers = np.abs(lags[:, None] + [1.0, 0.0, -1.0]) ** (2 * hurst)
    eigenvalues = np.fft.fft(powers @ [0.5, -1.0, 0.5]).real
    white = random.standard_normal((3, 2 * frames)) + 1j * random.standard_normal((3, 2 * frames))
    drawn = np.fft.fft(white * np.sqrt(np.maximum(eigenvalues, 0) / (2 * frames)), axis=1)
    return np.asarray(drawn.real[:, :frames], np.float64)


PROCESSES: Mapping[Kind, Callable[[float, np.random.Generator, int], Floats]] = {
    "first_order": _first_order,
    "window": _window,
    "regimes": _regimes,
    "fractional": fractional,
}
