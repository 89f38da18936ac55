"""The motion of an image relative to the previous one: shift along rows and columns, and roll about the centre.

    second(x + shift + roll × x) ≈ first(x)

**Conventions.** Images are brightness (H, W), float; x is from the centre, right and down. Whole pixels are found by
correlation, the rest by Gauss–Newton on brightness. Each pixel is weighted by one over its difference, so that moving
objects have little effect. Sources: Kuglin and Hines, 1975; Lucas and Kanade, 1981.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

ROUNDS, SETTLED_PX = 5, 0.02
LEAST_SIDE_PX = 16
SMOOTHED_PX = 1.0
LEAST_KNOWN_RATIO = 0.3
# Images with less contrast show no motion.
LEAST_CONTRAST = 1.0

Picture = NDArray[np.float32]
Array = NDArray[np.float64]


def brightness_of(pixels: NDArray[np.uint8]) -> Picture:
    """Return the brightness (H, W) of pixels (H, W, 3), smoothed by a pixel, because single-pixel slopes are noise."""
    return np.asarray(gaussian_filter(pixels.astype(np.float32).mean(axis=2), SMOOTHED_PX), np.float32)


def picture_shift(first: Picture, second: Picture) -> Array | None:
    """Return (3,) pixels right, pixels down, radians clockwise; None if the images are too small or without
    contrast.
    """
    is_large = first.shape == second.shape and min(first.shape) >= LEAST_SIDE_PX
    if not is_large or min(float(first.std()), float(second.std())) < LEAST_CONTRAST:
        return None
    shift = np.array([*_whole_pixels(first, second), 0.0])
    rows, columns = (axis.astype(np.float64) for axis in np.mgrid[: first.shape[0], : first.shape[1]])
    down, right = rows - (first.shape[0] - 1) / 2, columns - (first.shape[1] - 1) / 2
    for _ in range(ROUNDS):
        places = np.stack([rows + shift[1] + shift[2] * right, columns + shift[0] - shift[2] * down])
        moved = map_coordinates(second, places, order=1, mode="nearest")
        size = np.array(first.shape)[:, None, None]
        is_known = ((places > 1) & (places < size - 2)).all(axis=0)
        if is_known.mean() < LEAST_KNOWN_RATIO:
            return None
        slope_down, slope_right = np.gradient(moved)
        turned = slope_down * right - slope_right * down
        slopes = np.stack([slope_right[is_known], slope_down[is_known], turned[is_known]], axis=1)
        change = _step(slopes, (first - moved)[is_known])
        if change is None:
            return None
        shift = shift + change
        if np.abs(change[:2]).max() < SETTLED_PX:
            break
    return shift


def _step(slopes: Array, apart: Array) -> Array | None:
    apart = apart - apart.mean()
    size = np.abs(apart)
    weights = 1 / np.maximum(size, float(np.median(size)) + 1.0)
    weighted = slopes * weights[:, None]
    normal = weighted.T @ slopes
    if np.linalg.cond(normal) > 1e12:
        return None
    return np.asarray(np.linalg.solve(normal, weighted.T @ apart))


def _whole_pixels(first: Picture, second: Picture) -> tuple[int, int]:
    """Return the best of no shift, the correlation peak and the phase correlation peak, as pixels right and down.

    Moving objects can have the sharper peak, but cover less area.
    """
    height, width = first.shape
    window = np.outer(np.hanning(height), np.hanning(width))
    spectrum_1, spectrum_2 = (np.fft.rfft2((picture - picture.mean()) * window) for picture in (first, second))
    cross = spectrum_1.conj() * spectrum_2
    size = np.abs(cross)
    peaks = [(0, 0)]
    for spectrum in (cross, cross / (size + 1e-3 * size.mean())):
        correlation = np.fft.irfft2(spectrum, s=first.shape)
        down, right = (int(at) for at in np.unravel_index(np.argmax(correlation), correlation.shape))
        peaks.append((_wrapped(right, width), _wrapped(down, height)))
    return min(peaks, key=lambda shift: _apart(first, second, shift))


def _apart(first: Picture, second: Picture, shift: tuple[int, int]) -> float:
    """Return the median difference in the overlap of both images; infinite for little overlap."""
    right, down = shift
    height, width = first.shape
    if abs(right) > width * (1 - LEAST_KNOWN_RATIO) or abs(down) > height * (1 - LEAST_KNOWN_RATIO):
        return float("inf")
    one_part = first[max(0, -down) : height - max(0, down), max(0, -right) : width - max(0, right)]
    other_part = second[max(0, down) : height - max(0, -down), max(0, right) : width - max(0, -right)]
    return float(np.median(np.abs(one_part - other_part)))


def _wrapped(at: int, size: int) -> int:
    return at - size if at > size // 2 else at
