"""Demosaicing: colours of a Bayer image, whose sensor sees one of them per pixel.

**Conventions.** A pattern names the colours of the upper left 2 × 2 pixels, row by row, as ROS does ("rggb").
Bilinear: a missing colour is the mean of its nearest known neighbours, weighted 1 : 2 : 1 in both directions; at the
border those that exist. Source: sensor_msgs image_encodings; Malvar, He, Cutler, ICASSP 2004, section 2 (bilinear).
"""

import numpy as np
from numpy.typing import NDArray

CHANNELS = "rgb"


def debayered(mosaic: NDArray[np.uint8], pattern: str) -> NDArray[np.uint8]:
    """(H, W, 3) red, green, blue from (H, W)."""
    picture = np.empty((*mosaic.shape, 3), np.uint8)
    for channel, colour in enumerate(CHANNELS):
        known = np.zeros(mosaic.shape, np.uint16)
        for place, name in enumerate(pattern):
            known[place // 2 :: 2, place % 2 :: 2] = name == colour
        weights = _spread(known)
        sums = _spread(known * mosaic)
        # A picture of one row or column may lack a colour altogether: it stays 0 there.
        picture[..., channel] = (sums + weights // 2) // np.maximum(weights, 1)
    return picture


def binned(mosaic: NDArray[np.uint8], pattern: str) -> NDArray[np.uint8]:
    """(H // 2, W // 2, 3): every 2 × 2 pixels become one, green the mean of its two; for previews."""
    height, width = (size - size % 2 for size in mosaic.shape)
    sums = np.zeros((height // 2, width // 2, 3), np.uint16)
    for place, name in enumerate(pattern):
        sums[..., CHANNELS.index(name)] += mosaic[place // 2 : height : 2, place % 2 : width : 2]
    return (sums // np.array([1, 2, 1], np.uint16)).astype(np.uint8)


def _spread(values: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Sum over 3 × 3 neighbours with weights (1, 2, 1) in both directions, nothing beyond the border."""
    for axis in (0, 1):
        lined = np.moveaxis(values, axis, 0)
        total = lined * np.uint16(2)
        total[1:] += lined[:-1]
        total[:-1] += lined[1:]
        values = np.moveaxis(total, 0, axis)
    return values
