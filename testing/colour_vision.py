"""Differences between two colours, in normal sight and under simulated colour blindness.

**Conventions.** Colours are sRGB of 8 bits, (…, 3). A dichromacy is a matrix on linear RGB, severity 1; differences are
CIEDE2000 (kL = kC = kH = 1), white point D65.

Source: Machado, Oliveira and Fernandes 2009, table 2; Sharma, Wu and Dalal 2005, equations 2–22.
"""

from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

VISIONS: dict[str, Floats] = {
    "normal": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
_XYZ_FROM_RGB = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
_WHITE = np.array([0.95047, 1.0, 1.08883])


def lab_of(rgb: ArrayLike, vision: str = "normal") -> Floats:
    """Return CIE L*a*b* of a colour in this vision."""
    share = np.asarray(rgb, np.float64) / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    xyz = np.clip(linear @ VISIONS[vision].T, 0.0, 1.0) @ _XYZ_FROM_RGB.T / _WHITE
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], -1)


def ciede2000(a: ArrayLike, b: ArrayLike) -> Floats:
    """Return the difference of two colours in L*a*b*."""
    (l1, a1, b1), (l2, a2, b2) = np.moveaxis(np.asarray(a, np.float64), -1, 0), np.moveaxis(np.asarray(b, float), -1, 0)
    mean7 = ((np.hypot(a1, b1) + np.hypot(a2, b2)) / 2) ** 7
    wider = 1 + 0.5 * (1 - np.sqrt(mean7 / (mean7 + 25.0**7)))
    c1, c2 = np.hypot(a1 * wider, b1), np.hypot(a2 * wider, b2)
    h1, h2 = np.degrees(np.arctan2(b1, a1 * wider)) % 360, np.degrees(np.arctan2(b2, a2 * wider)) % 360
    turn = (h2 - h1 + 180) % 360 - 180
    hue = np.where(np.abs(h1 - h2) > 180, (h1 + h2 + 360) / 2 % 360, (h1 + h2) / 2)
    lightness, chroma = (l1 + l2) / 2, (c1 + c2) / 2
    t = 1 - 0.17 * _cos(hue - 30) + 0.24 * _cos(2 * hue) + 0.32 * _cos(3 * hue + 6) - 0.20 * _cos(4 * hue - 63)
    by_l = (l2 - l1) / (1 + 0.015 * (lightness - 50) ** 2 / np.sqrt(20 + (lightness - 50) ** 2))
    by_c = (c2 - c1) / (1 + 0.045 * chroma)
    by_h = 2 * np.sqrt(c1 * c2) * np.sin(np.radians(turn / 2)) / (1 + 0.015 * chroma * t)
    rotation = -2 * np.sqrt(chroma**7 / (chroma**7 + 25.0**7))
    rotation = rotation * np.sin(np.radians(60 * np.exp(-(((hue - 275) / 25) ** 2))))
    return np.asarray(np.sqrt(by_l**2 + by_c**2 + by_h**2 + rotation * by_c * by_h))


def difference(a: ArrayLike, b: ArrayLike, vision: str = "normal") -> float:
    """Return the difference of two sRGB colours in this vision."""
    return float(ciede2000(lab_of(a, vision), lab_of(b, vision)))


def least_difference(a: ArrayLike, b: ArrayLike) -> float:
    """Return the smallest difference of two sRGB colours in any vision."""
    return min(difference(a, b, vision) for vision in VISIONS)


def least_of_pairs(colours: list[tuple[int, int, int]], lights: ArrayLike = (1.0,)) -> float:
    """Return the smallest difference of any two of these colours, at any of these brightnesses, in any vision."""
    lit = np.clip(np.asarray(colours, np.float64)[:, None] * np.asarray(lights, np.float64)[None, :, None], 0, 255)
    seen = [lab_of(lit, vision) for vision in VISIONS]
    return min(
        float(ciede2000(lab[i][:, None], lab[j][None]).min())
        for lab in seen
        for i, j in combinations(range(len(colours)), 2)
    )


def _cos(degrees: Floats) -> Floats:
    return np.cos(np.radians(degrees))
