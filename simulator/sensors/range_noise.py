"""Faults of a real LiDAR's ranges: surfaces that return too little, beams on an edge, drops in the air.

**Conventions.** A sweep's rays are (columns · channels,) in firing order, a column after another; no return is inf. Of
each ray: the range of the surface it meets, the cosine of the incidence there, and the reflectivity in [0, 1].

- *Dropouts*. The mean power returned goes as reflectivity · cos(incidence) / range² (Lambert); speckle makes it
  exponentially distributed around its mean (Goodman, Speckle Phenomena in Optics, ch. 2), so a share
  exp(−threshold / mean) of the pulses is detected.
- *Mixed pixels*. A beam as wide as `beam_rad` lies across the edge between its own surface and that of the next column
  in the share of cases that it fills of the angle between them. Echoes closer than a pulse's length are one, somewhere
  between the two surfaces.
- *Rain*. Drops, insects and dust stop a ray at a constant rate along it, as far as they return enough.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Ranges = NDArray[np.float32]
DARKEST = 1e-9


@dataclass(frozen=True)
class RangeNoise:
    """How much of it: of a surface of `half_reflectivity`, met head-on at `half_range_m`, half the pulses come back.

    The defaults are those of small LiDARs of 16 to 64 channels: 45 m on 10 %, 3 mrad, a pulse of 10 ns; and moderate
    rain, 2 of 1,000 rays.
    """

    half_range_m: float = 45.0
    half_reflectivity: float = 0.1
    beam_rad: float = 0.003
    least_gap_m: float = 0.1
    pulse_m: float = 1.5
    drops_per_m: float = 1e-4
    drops_reach_m: float = 20.0


@dataclass(frozen=True, eq=False)
class Returns:
    """What the rays of one sweep meet: range (N,), cosine of incidence (N,), reflectivity (N,)."""

    range_m: Ranges
    cosine: Ranges
    reflectivity: Ranges


def disturbed(returns: Returns, channels: int, noise: RangeNoise, rng: np.random.Generator) -> Ranges:
    """The ranges (N,) with mixed pixels, dropouts and rain, in this order."""
    range_m = mixed(returns.range_m, channels, noise, rng)
    range_m = np.where(rng.random(len(range_m)) < detected_share(returns, noise), range_m, np.float32(np.inf))
    return rained(range_m, noise, rng)


def detected_share(returns: Returns, noise: RangeNoise) -> Ranges:
    """The share of pulses that comes back from each surface (N,)."""
    lit = np.maximum(returns.reflectivity * returns.cosine, DARKEST) / noise.half_reflectivity
    return np.asarray(np.exp2(-((returns.range_m / noise.half_range_m) ** 2) / lit), np.float32)


def mixed(range_m: Ranges, channels: int, noise: RangeNoise, rng: np.random.Generator) -> Ranges:
    """The ranges with those of beams on an edge drawn between its two surfaces."""
    following = np.roll(range_m, -channels)
    is_wide = rng.random(len(range_m)) < noise.beam_rad * (len(range_m) // channels) / (2 * np.pi)
    part = rng.random(len(range_m), np.float32)
    with np.errstate(invalid="ignore"):  # inf − inf: both rays miss
        gap_m = following - range_m
        is_edge = (np.abs(gap_m) > noise.least_gap_m) & (np.abs(gap_m) < noise.pulse_m)
        return np.where(is_edge & is_wide, range_m + part * gap_m, range_m)


def rained(range_m: Ranges, noise: RangeNoise, rng: np.random.Generator) -> Ranges:
    """The ranges with those of rays that end at a drop before they meet anything."""
    drop_m = rng.standard_exponential(len(range_m), np.float32) / np.float32(noise.drops_per_m)
    return np.where(drop_m < np.minimum(range_m, noise.drops_reach_m), drop_m, range_m).astype(np.float32)
