"""The record of a run's drift in z relative to the ground (`stone.sensors.ground_links`)."""

from dataclasses import dataclass

# Drift of 1 % is 0.12 m within reach. Sound runs (simulated ones of up to 200 m, and KITTI's 70 m) have up to 0.055 m.
TOLERATED_M = 0.08
MOST_APART_M = 0.6  # 5 % within reach: more is not drift


@dataclass(frozen=True)
class HeightDrift:
    """Drift from `looks` at the ground with `links` between them, in metres.

    The first fields are the largest height difference of two looks at the same ground with the original poses, for all
    looks and for looks of one visit. Then follow the 95th percentile of the corrected difference, the range of the
    corrections, and the driven distance. `is_followed`: the poses were corrected.
    """

    looks: int
    links: int
    apart_m: float
    visit_apart_m: float
    left_m: float
    span_m: float
    driven_m: float
    is_followed: bool = False

    @property
    def is_beyond_terrain(self) -> bool:
        """Whether the looks differ more than terrain and noise explain."""
        return self.apart_m > TOLERATED_M

    @property
    def is_followable(self) -> bool:
        """Whether the drift is slow and vanishes with the corrections."""
        return self.visit_apart_m <= MOST_APART_M and self.left_m <= TOLERATED_M
