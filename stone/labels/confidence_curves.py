"""The curves of `stone.labels.confidence`, as `python -m benchmarks.confidence --fit` prints them."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Curve:
    """A piecewise linear function.

    It is `start` up to the first knot; its slope changes by `weights` (n,) at the `knots` (n,), and is 0 beyond `end`.
    """

    knots: tuple[float, ...]
    end: float
    weights: tuple[float, ...]
    start: float = 0.0


@dataclass(frozen=True)
class Curves:
    """The log odds that a voxel is drivable: the intercept and the sum of the curves of its `properties`, by name.

    `p_right` and `n_right` map what they are worth for the label P or N to the log odds that this label is right.
    """

    intercept: float
    properties: Mapping[str, Curve]
    p_right: Curve
    n_right: Curve


CURVES = Curves(
    intercept=5.589,
    properties={
        "slope_ratio": Curve(
            knots=(0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.75),
            end=5.0,
            weights=(-0.6916, -0.2126, -0.2055, -3.895, -1.117, 2.106, 0.8075),
            start=0.0,
        ),
        "step_ratio": Curve(
            knots=(0.0, 0.5, 0.8, 1.2, 2.0, 4.0),
            end=16.0,
            weights=(1.232, 0.779, -0.2278, -1.353, -0.9244, 0.7731),
            start=0.0,
        ),
        "clearance_ratio": Curve(
            knots=(0.0, 0.5, 0.8, 1.0, 1.25), end=4.0, weights=(-0.1124, -1.031, -0.8858, -0.5126, -0.02979), start=0.0
        ),
        "height_sigmas": Curve(
            knots=(-1.0, 0.0, 1.0, 2.0, 4.0), end=16.0, weights=(0.5452, -0.115, -0.3841, -0.3017, 0.1133), start=0.0
        ),
        "slope_sigmas": Curve(
            knots=(-1.0, 0.0, 1.0, 2.0, 3.0), end=10.0, weights=(1.163, -0.3443, -0.6269, -0.0848, 0.05191), start=0.0
        ),
        "roughness_sigmas": Curve(
            knots=(-2.0, 0.0, 1.0, 2.0, 3.0), end=10.0, weights=(0.0308, -0.09845, 0.322, 0.6507, 0.1361), start=0.0
        ),
        "distance_ratio": Curve(
            knots=(0.0, 0.5, 1.0, 1.5, 2.5, 5.0),
            end=10.0,
            weights=(-1.367, -0.9218, -0.0781, 0.832, 0.7462, 0.1845),
            start=0.0,
        ),
        "pooled_slope_ratio": Curve(
            knots=(0.25, 0.5, 0.75, 1.0, 1.25, 1.75),
            end=4.0,
            weights=(-2.316, 0.1133, -1.628, -0.8653, 2.002, 0.847),
            start=0.0,
        ),
        "height_m": Curve(
            knots=(0.0, 0.05, 0.1, 0.2, 0.4), end=1.4, weights=(-0.9133, -1.872, -3.043, 1.39, -0.2417), start=0.0
        ),
        "roughness_log_m2": Curve(
            knots=(-12.0, -10.0, -8.0, -6.0), end=-2.0, weights=(-0.7353, -0.3812, 0.5313, 3.649), start=0.0
        ),
    },
    p_right=Curve(
        knots=(-6.0, -4.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 6.0),
        end=12.0,
        weights=(0.1027, 0.1426, 0.1714, 0.1871, 0.1336, 0.001753, 0.1165, -0.02725, 0.4331, 0.7875, 2.682),
        start=-1.969,
    ),
    n_right=Curve(
        knots=(-6.0, -4.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 6.0),
        end=12.0,
        weights=(0.3514, 0.4453, 0.3981, 0.1401, -0.1559, -0.3377, -0.2256, 0.09216, 0.1592, 0.1229, -0.3896),
        start=-4.729,
    ),
)
