"""The curves of `stone.labels.confidence`, as `python -m benchmarks.confidence --fit` prints them."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Curve:
    """A piecewise linear function: its slope changes by `weights` (n,) at the `knots` (n,), and is 0 beyond `end`."""

    knots: tuple[float, ...]
    end: float
    weights: tuple[float, ...]


@dataclass(frozen=True)
class Curves:
    """The log odds: the intercept and the sum of the curves of the properties, by name."""

    intercept: float
    curves: Mapping[str, Curve]


CURVES = Curves(
    intercept=5.589,
    curves={
        "slope_ratio": Curve(
            (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.75), 5.0, (-0.6916, -0.2126, -0.2055, -3.895, -1.117, 2.106, 0.8075)
        ),
        "step_ratio": Curve((0.0, 0.5, 0.8, 1.2, 2.0, 4.0), 16.0, (1.232, 0.779, -0.2278, -1.353, -0.9244, 0.7731)),
        "clearance_ratio": Curve((0.0, 0.5, 0.8, 1.0, 1.25), 4.0, (-0.1124, -1.031, -0.8858, -0.5126, -0.02979)),
        "height_sigmas": Curve((-1.0, 0.0, 1.0, 2.0, 4.0), 16.0, (0.5452, -0.115, -0.3841, -0.3017, 0.1133)),
        "slope_sigmas": Curve((-1.0, 0.0, 1.0, 2.0, 3.0), 10.0, (1.163, -0.3443, -0.6269, -0.0848, 0.05191)),
        "roughness_sigmas": Curve((-2.0, 0.0, 1.0, 2.0, 3.0), 10.0, (0.0308, -0.09845, 0.322, 0.6507, 0.1361)),
        "distance_ratio": Curve(
            (0.0, 0.5, 1.0, 1.5, 2.5, 5.0), 10.0, (-1.367, -0.9218, -0.0781, 0.832, 0.7462, 0.1845)
        ),
        "pooled_slope_ratio": Curve(
            (0.25, 0.5, 0.75, 1.0, 1.25, 1.75), 4.0, (-2.316, 0.1133, -1.628, -0.8653, 2.002, 0.847)
        ),
        "height_m": Curve((0.0, 0.05, 0.1, 0.2, 0.4), 1.4, (-0.9133, -1.872, -3.043, 1.39, -0.2417)),
        "roughness_log_m2": Curve((-12.0, -10.0, -8.0, -6.0), -2.0, (-0.7353, -0.3812, 0.5313, 3.649)),
    },
)
