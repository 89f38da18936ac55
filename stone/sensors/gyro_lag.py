"""The lag of a gyro's stamps behind a source of orientations, from the turns that both measured.

    rate of turn(t) ≈ R ω(t + lag) + b,   with the lag that gives the best agreement

**Conventions.** The rate of turn is the rotation between two orientations, in the source's own axes, divided by the
time between them. The gyro is integrated over the same time, so that neither is differentiated or resampled. The
rotation `R` and the bias `b` are fitted, so the gyro's mount need not be known. All three axes are used, because rough
ground rolls and pitches a robot faster than it yaws. On simulated drives of 6 s the error is 0.3 ms; with yaw only, 8
ms. A positive lag means that the gyro's stamps are late. Orientations are `wxyz`. Source: generalised cross-correlation
(Knapp and Carter, 1976) with a fitted mount (Kabsch, 1976). The standard error is that of least squares: residual over
the slope of the signal. The best lag is found by golden sections (Kiefer, 1953), because loading SciPy's optimisers
takes a third of a second, a fifth of `stone inspect`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import multiply

Stamps = NDArray[np.int64]
Array = NDArray[np.float64]

MAX_LAG_S = 0.5
COARSE_STEP_S = 0.01
FINE_STEP_S = 1e-6
GOLDEN = (5**0.5 - 1) / 2
# Turns over less time are mostly noise; sources at 20 Hz are used unchanged.
LEAST_STEP_S = 0.045
# A gap is an interval longer than this many typical intervals.
GAP_RATIO = 2.5
# Three seconds at 20 Hz: fewer smooth turns can match any other moment under some mount.
LEAST_TURNS = 60
SLOPE_STEP_S = 0.001
LAST_RATE_RAD_S = 1000.0
FITTED = 7  # a rotation, a bias, the lag


@dataclass(frozen=True)
class GyroLag:
    """`correlation` (0 to 1) is the multiple correlation of the fit at `lag_ns`."""

    lag_ns: int
    sigma_ns: int
    correlation: float


@dataclass(frozen=True, eq=False)
class Turns:
    """K steps of the source: start and end (K,) in seconds, and the mean rates (K, 3) between them."""

    begin_s: Array
    end_s: Array
    rates_rad_s: Array

    def centred(self) -> Array:
        return np.asarray(self.rates_rad_s - self.rates_rad_s.mean(axis=0))


@dataclass(frozen=True, eq=False)
class _Gyro:
    """The integral (N, 3) of the rates up to each of N times."""

    time_s: Array
    angle_rad: Array

    def rates_between(self, turns: Turns, lag_s: float) -> Array:
        """Return the mean rates (K, 3) over the steps, `lag_s` later, without their common part."""
        begin_s, end_s = turns.begin_s + lag_s, turns.end_s + lag_s
        turned = [
            np.interp(end_s, self.time_s, axis) - np.interp(begin_s, self.time_s, axis) for axis in self.angle_rad.T
        ]
        rates = np.stack(turned, axis=-1) / (end_s - begin_s)[:, None]
        return np.asarray(rates - rates.mean(axis=0))


def gyro_lag(gyro: tuple[Stamps, Array], source: tuple[Stamps, Array]) -> GyroLag | None:
    """Return the lag from rates (N, 3) in rad/s and orientations (K, 4), each with its stamps, in any order.

    Return None if fewer than `LEAST_TURNS` steps lie within the gyro's record, or if nothing turns. Return None too if
    the best agreement is at the end of the search (± `MAX_LAG_S`), which is not a peak.
    """
    (gyro_ns, rates), (source_ns, wxyz) = _ordered(*gyro), _ordered(*source)
    if len(gyro_ns) < 2 or len(source_ns) < 2:
        return None
    start_ns = int(source_ns[0])
    time_s, source_s = _seconds(gyro_ns, start_ns), _seconds(source_ns, start_ns)
    turns = _inside(turns_of(source_s, wxyz), time_s)
    if len(turns.begin_s) < LEAST_TURNS or not turns.centred().any():
        return None
    integral = _Gyro(time_s, _integrated(time_s, rates))
    return _best(integral, turns)


def turns_of(time_s: Array, wxyz: Array) -> Turns:
    """Return the steps between orientations at least `LEAST_STEP_S` apart, without steps over gaps."""
    stride = max(1, round(LEAST_STEP_S / max(float(np.median(np.diff(time_s))), 1e-6)))
    time_s, wxyz = time_s[::stride], wxyz[::stride]
    step = multiply(wxyz[:-1] * np.array([1.0, -1, -1, -1]), wxyz[1:])
    step *= np.where(step[:, :1] < 0, -1.0, 1.0)
    sine = np.linalg.norm(step[:, 1:], axis=1)
    angle = 2 * np.arctan2(sine, step[:, 0])
    elapsed_s = np.diff(time_s)
    axis = step[:, 1:] / np.where(sine > 0, sine, 1.0)[:, None]
    is_whole = elapsed_s <= GAP_RATIO * np.median(elapsed_s) if len(elapsed_s) else np.zeros(0, np.bool_)
    rates = axis * (angle / elapsed_s)[:, None]
    return Turns(time_s[:-1][is_whole], time_s[1:][is_whole], rates[is_whole])


def _seconds(stamps_ns: Stamps, start_ns: int) -> Array:
    return (stamps_ns - start_ns).astype(np.float64) * 1e-9


def _ordered(stamps_ns: Stamps, values: Array) -> tuple[Stamps, Array]:
    """Return values in time order, the first of equal stamps, without rows of NaN or implausible rates."""
    is_possible = (np.abs(values) <= LAST_RATE_RAD_S).all(axis=1)
    unique_ns, first = np.unique(stamps_ns[is_possible], return_index=True)
    return unique_ns, values[is_possible][first]


def _inside(turns: Turns, time_s: Array) -> Turns:
    """Return the steps that the gyro covers without a gap, at every searched lag."""
    first = np.searchsorted(time_s, turns.begin_s - MAX_LAG_S, side="right") - 1
    last = np.searchsorted(time_s, turns.end_s + MAX_LAG_S, side="left")
    steps_s = np.diff(time_s)
    gaps = np.concatenate([[0], np.cumsum(steps_s > GAP_RATIO * np.median(steps_s))])
    is_inside = (first >= 0) & (last < len(time_s))
    is_whole = gaps[np.minimum(last, len(time_s) - 1)] == gaps[np.maximum(first, 0)]
    kept = is_inside & is_whole
    return Turns(turns.begin_s[kept], turns.end_s[kept], turns.rates_rad_s[kept])


def _integrated(time_s: Array, rates: Array) -> Array:
    """Integrate by trapezoids, after subtraction of the mean: the integral stays small, and the bias is fitted
    anyway.
    """
    centred = rates - rates.mean(axis=0)
    areas = (centred[1:] + centred[:-1]) / 2 * np.diff(time_s)[:, None]
    return np.concatenate([np.zeros((1, 3)), np.cumsum(areas, axis=0)])


def _best(gyro: _Gyro, turns: Turns) -> GyroLag | None:
    searched = np.arange(-MAX_LAG_S, MAX_LAG_S + COARSE_STEP_S / 2, COARSE_STEP_S)
    agreements = [_agreement(gyro, turns, lag_s) for lag_s in searched.tolist()]
    at = int(np.argmax(agreements))
    if at in (0, len(searched) - 1):
        return None
    lag_s, correlation = peak(lambda lag_s: _agreement(gyro, turns, lag_s), (searched[at - 1], searched[at + 1]))
    sigma_s = _sigma_s(gyro, turns, lag_s)
    return None if sigma_s is None else GyroLag(round(lag_s * 1e9), round(sigma_s * 1e9), min(correlation, 1.0))


def peak(height: Callable[[float], float], bounds: tuple[float, float]) -> tuple[float, float]:
    """Return the position, within `FINE_STEP_S`, and height of the maximum of a function with one maximum in
    `bounds`.
    """
    low, high = map(float, bounds)
    left, right = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
    of_left, of_right = height(left), height(right)
    while high - low > FINE_STEP_S:
        if of_left >= of_right:
            high, right, of_right = right, left, of_left
            left = high - GOLDEN * (high - low)
            of_left = height(left)
        else:
            low, left, of_left = left, right, of_right
            right = low + GOLDEN * (high - low)
            of_right = height(right)
    return (left, of_left) if of_left >= of_right else (right, of_right)


def _agreement(gyro: _Gyro, turns: Turns, lag_s: float) -> float:
    """Return the correlation of the rates under the best rotation (Kabsch, 1976; including reflections)."""
    rates, turned = gyro.rates_between(turns, lag_s), turns.centred()
    energy = float(np.sum(rates**2) * np.sum(turned**2))
    return float(np.linalg.svd(rates.T @ turned, compute_uv=False).sum()) / np.sqrt(energy) if energy > 0 else 0.0


def _sigma_s(gyro: _Gyro, turns: Turns, lag_s: float) -> float | None:
    """Return the standard error of the lag; None if the source's rates never change.

    Changes that a small turn of the mount explains as well carry no information about the lag. The gyro's slope
    includes noise that moves with the lag, so it counts only in the error, never in the signal.
    """
    rates, turned = gyro.rates_between(turns, lag_s), turns.centred()
    u, _, v = np.linalg.svd(rates.T @ turned)
    mount = u @ v
    tilts = np.stack([np.cross(turned, axis).ravel() for axis in np.eye(3)], axis=-1)
    slope = gyro.rates_between(turns, lag_s + SLOPE_STEP_S) - gyro.rates_between(turns, lag_s - SLOPE_STEP_S)
    noisy = _energy_beside(slope @ mount / (2 * SLOPE_STEP_S), tilts)
    signal = _energy_beside(np.gradient(turned, turns.begin_s, axis=0), tilts)
    if signal == 0:
        return None
    error = float(np.sum((rates @ mount - turned) ** 2)) / (turned.size - FITTED)
    return float(np.sqrt(error * max(noisy, signal))) / signal


def _energy_beside(slope_per_s: Array, tilts: Array) -> float:
    """Return the sum of squares of the slope after the tilts (3K, 3) are fitted to it."""
    flat = slope_per_s.ravel()
    return float(np.sum((flat - tilts @ np.linalg.lstsq(tilts, flat, rcond=None)[0]) ** 2))
