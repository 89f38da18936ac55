"""The curves of `stone.labels.confidence`, printed by `python -m benchmarks.confidence --fit`."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Curve:
    """A piecewise linear function.

    It equals `start` up to the first knot; its slope changes by `weights` (n,) at the `knots` (n,), and is 0 beyond
    `end`.
    """

    knots: tuple[float, ...]
    end: float
    weights: tuple[float, ...]
    start: float = 0.0


@dataclass(frozen=True)
class Curves:
    """The log odds that a voxel is drivable: the intercept plus the sum of the curves of its `properties`, by name.

    `p_right` and `n_right` map these log odds to the log odds that a label P or N is right.
    """

    intercept: float
    properties: Mapping[str, Curve]
    p_right: Curve
    n_right: Curve


CURVES = Curves(
    intercept=5.444,
    properties={
        "slope_ratio": Curve(
            knots=(0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.75),
            end=5.0,
            weights=(-0.6473, -0.2181, -0.2084, -3.831, -0.9862, 2.274, 0.8521),
            start=0.0,
        ),
        "step_ratio": Curve(
            knots=(0.0, 0.5, 0.8, 1.2, 2.0, 4.0),
            end=16.0,
            weights=(1.306, 0.7928, -0.2616, -1.368, -0.8284, 0.8821),
            start=0.0,
        ),
        "clearance_ratio": Curve(
            knots=(0.0, 0.5, 0.8, 1.0, 1.25), end=4.0, weights=(-0.07894, -1.026, -0.8743, -0.4866, -0.00374), start=0.0
        ),
        "height_sigmas": Curve(
            knots=(-1.0, 0.0, 1.0, 2.0, 4.0), end=16.0, weights=(0.5506, -0.1617, -0.4591, -0.2271, 0.09549), start=0.0
        ),
        "slope_sigmas": Curve(
            knots=(-1.0, 0.0, 1.0, 2.0, 3.0), end=10.0, weights=(1.247, -0.4111, -0.7642, -0.5299, 1.029), start=0.0
        ),
        "roughness_sigmas": Curve(
            knots=(-2.0, 0.0, 1.0, 2.0, 3.0), end=10.0, weights=(0.03909, -0.09943, 0.3246, 0.7208, 0.02699), start=0.0
        ),
        "distance_ratio": Curve(
            knots=(0.0, 0.5, 1.0, 1.5, 2.5, 5.0),
            end=10.0,
            weights=(-1.398, -0.9707, 0.004155, 0.8909, 0.4217, 0.07477),
            start=0.0,
        ),
        "pooled_slope_ratio": Curve(
            knots=(0.25, 0.5, 0.75, 1.0, 1.25, 1.75),
            end=4.0,
            weights=(-2.209, 0.2322, -1.515, -1.174, 1.396, 0.5033),
            start=0.0,
        ),
        "height_m": Curve(
            knots=(0.0, 0.05, 0.1, 0.2, 0.4), end=1.4, weights=(-0.6227, -1.794, -3.321, 1.182, -0.05447), start=0.0
        ),
        "roughness_log_m2": Curve(
            knots=(-12.0, -10.0, -8.0, -6.0), end=-2.0, weights=(-0.7369, -0.3991, 0.5658, 3.459), start=0.0
        ),
    },
    p_right=Curve(
        knots=(-6.0, -4.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 6.0),
        end=12.0,
        weights=(0.1118, 0.1554, 0.184, 0.182, 0.1491, -0.006619, 0.07971, 0.04288, 0.3055, 0.8452, 2.89),
        start=-2.154,
    ),
    n_right=Curve(
        knots=(-6.0, -4.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 6.0),
        end=12.0,
        weights=(0.2483, 0.3283, 0.3679, 0.2486, -0.05009, -0.2953, -0.2438, 0.1059, 0.1382, 0.1389, -0.3616),
        start=-3.879,
    ),
)
