"""Noise that is a function of place: values on integer lattices, looked up in a shuffled table, so it needs no state.

**Conventions.** Places are in metres in the map frame, (N, 2) or (N, 3) float32. `footprint_m` (N,) is how much of the
surface one pixel covers: an octave fades out as its wavelength falls from two footprints to one, below which it would
only flicker. An octave's values lie in [−1, 1]; each next one has half the wavelength and half the amplitude, so that a
sum lies in (−1, 1) with a deviation of about 0.2. Each layer is another noise; one repeats itself after 1,024 waves.
Method: value noise on a permutation table (Perlin 1985, "An image synthesizer", sections 3 and 5).
"""

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float32]
SIZE = 1024
_drawn = np.random.Generator(np.random.PCG64(1985))
_SHUFFLED = np.tile(_drawn.permutation(SIZE).astype(np.int32), 2)
_VALUES = np.tile(_drawn.permutation(np.linspace(-1, 1, SIZE)).astype(np.float32), 2)
_MASK = SIZE - 1
FIRST = np.float32(0.5)  # the amplitude of the first octave


def single(values: Sequence[float]) -> Floats:
    """These in single precision, so that what is computed with them stays in it."""
    return np.array(values, np.float32)


def plane_fractal(xy: Floats, wavelength_m: float, octaves: int, footprint_m: Floats, layer: int) -> Floats:
    """Octaves from `wavelength_m` down, as far as each pixel shows them (N,)."""
    result: Floats = _fractal(xy, wavelength_m, octaves, footprint_m, layer)
    return result


def space_fractal(points: Floats, wavelength_m: float, octaves: int, footprint_m: Floats, layer: int) -> Floats:
    """The same in space (N,)."""
    result: Floats = _fractal(points, wavelength_m, octaves, footprint_m, layer)
    return result


def cell_values(i: NDArray[np.int64], j: NDArray[np.int64], layer: int) -> Floats:
    """A value in [−1, 1] for each cell of a lattice (N,); neighbours have nothing in common."""
    return np.asarray(_VALUES[_SHUFFLED[_SHUFFLED[(i + layer) & _MASK] + (j & _MASK)]])


def visible(wavelength_m: float, footprint_m: Floats) -> Floats:
    """How much of an octave pixels of this footprint show (N,), 0 to 1."""
    return np.asarray(np.clip(np.float32(wavelength_m) / footprint_m - 1, 0, 1))


@njit(cache=True, nogil=True, error_model="numpy")
def _fractal(points, wavelength_m, octaves, footprint_m, layer):  # type: ignore[no-untyped-def]
    total = np.zeros(len(points), np.float32)
    for index in range(len(points)):
        amplitude, wavelength = FIRST, np.float32(wavelength_m)
        for octave in range(octaves):
            shown = wavelength / footprint_m[index] - np.float32(1)
            if shown <= 0:
                break
            shown = min(shown, np.float32(1))
            scale, start = 1 / wavelength, _SHUFFLED[(layer + octave) & _MASK]
            x, y = points[index, 0] * scale, points[index, 1] * scale
            if points.shape[1] == 2:
                value = _plane(x, y, start)
            else:
                z = points[index, 2] * scale
                low = math.floor(z)
                w = _eased(z - np.float32(low))
                value = _plane(x, y, _SHUFFLED[(start + low) & _MASK]) * (1 - w)
                value += _plane(x, y, _SHUFFLED[(start + low + 1) & _MASK]) * w
            total[index] += shown * amplitude * value
            amplitude, wavelength = amplitude * FIRST, wavelength * FIRST
    return total


@njit(cache=True, nogil=True)
def _plane(x, y, start):  # type: ignore[no-untyped-def]
    i, j = math.floor(x), math.floor(y)
    u, v = _eased(x - np.float32(i)), _eased(y - np.float32(j))
    left, right, row = _SHUFFLED[(start + i) & _MASK], _SHUFFLED[(start + i + 1) & _MASK], j & _MASK
    low = _VALUES[_SHUFFLED[left + row]] * (1 - u) + _VALUES[_SHUFFLED[right + row]] * u
    high = _VALUES[_SHUFFLED[left + row + 1]] * (1 - u) + _VALUES[_SHUFFLED[right + row + 1]] * u
    return low * (1 - v) + high * v


@njit(cache=True, nogil=True)
def _eased(ratio):  # type: ignore[no-untyped-def]
    return ratio * ratio * (np.float32(3) - np.float32(2) * ratio)


def stones(xy: Floats, size_m: float, layer: int) -> tuple[Floats, Floats]:
    """Stones of about `size_m` strewn on the plane: how far inside one each place is (N,), 0 between stones and 1 in
    the middle of one, and that stone's tone (N,) in [−1, 1]."""
    inside, tone = _stones(xy, np.float32(size_m), layer)
    return inside, tone


@njit(cache=True, nogil=True, error_model="numpy")
def _stones(xy, size_m, layer):  # type: ignore[no-untyped-def]
    inside, tone = np.zeros(len(xy), np.float32), np.zeros(len(xy), np.float32)
    for index in range(len(xy)):
        x, y = xy[index, 0] / size_m, xy[index, 1] / size_m
        column, row = math.floor(x), math.floor(y)
        nearest, chosen = np.float32(9), 0
        for i in range(column - 1, column + 2):
            for j in range(row - 1, row + 2):
                cell = _SHUFFLED[_SHUFFLED[(i + layer) & _MASK] + (j & _MASK)]
                dx = np.float32(i) + np.float32(0.5) + np.float32(0.4) * _VALUES[cell] - x
                dy = np.float32(j) + np.float32(0.5) + np.float32(0.4) * _VALUES[cell + 1] - y
                distance = dx * dx + dy * dy
                if distance < nearest:
                    nearest, chosen = distance, cell
        inside[index] = max(1 - nearest / np.float32(0.3), np.float32(0))
        tone[index] = _VALUES[chosen + 2]
    return inside, tone
