"""Lights: sun or moon, sky, haze and camera exposure, for each illumination word of the platform.

**Conventions.** The words are those of `stone/splits/surroundings.py`. Light is linear (red, green, blue); 1 makes a
white surface white at exposure 1. Azimuth is counter-clockwise from east (map x), elevation above the horizon. The word
determines the light, not the recording's date. After sunset the robot's lamps are on.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from simulator.appearance.materials import Rgb
from stone.geometry.se3 import Array


@dataclass(frozen=True)
class Light:
    """The light of one illumination word.

    `beam` comes from one direction and casts shade; `zenith` and `horizon` are the sky's. `clouds` is roughly the cloud
    cover, −1 for none; `noise_8bit` the deviation of a dark pixel's value; `lamp` a lamp's strength, which halves at 1
    m.
    """

    elevation_deg: float
    azimuth_deg: float
    beam: Rgb
    zenith: Rgb
    horizon: Rgb
    clouds: float
    haze_m: float
    exposure: float
    noise_8bit: float
    lamp: float = 0.0

    @property
    def towards(self) -> Array:
        """Unit vector (3,) towards the beam's source, map frame."""
        up, round_ = np.deg2rad(self.elevation_deg), np.deg2rad(self.azimuth_deg)
        return np.array([np.cos(up) * np.cos(round_), np.cos(up) * np.sin(round_), np.sin(up)])

    @property
    def casts_shade(self) -> bool:
        return max(self.beam) > 0


LIGHTS: Mapping[str, Light] = {
    "day": Light(50, -48, (2.6, 2.45, 2.2), (0.30, 0.47, 0.85), (0.80, 0.88, 0.98), 0.55, 260, 1.15, 1.2),
    "sunny": Light(58, -60, (3.4, 3.2, 2.85), (0.20, 0.38, 0.82), (0.66, 0.80, 0.98), 0.10, 420, 1.0, 1.0),
    "overcast": Light(55, -60, (0, 0, 0), (0.95, 0.98, 1.02), (0.88, 0.91, 0.94), 0.85, 170, 1.35, 1.5),
    "dawn": Light(9, 35, (1.15, 0.72, 0.42), (0.20, 0.27, 0.45), (0.85, 0.62, 0.50), 0.45, 140, 1.9, 2.2),
    "dusk": Light(6, 150, (0.95, 0.48, 0.20), (0.14, 0.18, 0.36), (0.80, 0.47, 0.30), 0.50, 220, 2.2, 2.8),
    "night": Light(40, 0, (0, 0, 0), (0.0006, 0.0008, 0.0014), (0.0022, 0.0022, 0.0026), 0.3, 90, 4.0, 6.0, 7.0),
    "moonlit": Light(
        35, 100, (0.020, 0.023, 0.030), (0.0030, 0.0040, 0.0075), (0.0065, 0.0075, 0.0105), 0.3, 200, 6.0, 6.5, 3.0
    ),
    "floodlit": Light(
        38, 75, (0.42, 0.38, 0.30), (0.0012, 0.0012, 0.0014), (0.008, 0.007, 0.006), -1.0, 120, 2.6, 4.0, 3.5
    ),
}
