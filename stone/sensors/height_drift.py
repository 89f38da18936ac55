"""What the poses of a run drift in z against the ground (`stone.sensors.ground_links`), as a record."""

from dataclasses import dataclass

# Drift of 1 % is 0.12 m within reach. Sound runs, simulated ones of up to 200 m and KITTI's 70 m, have up to 0.055.
TOLERATED_M = 0.08
MOST_APART_M = 0.6  # 5 % within reach: no drift, whatever it is


@dataclass(frozen=True)
class HeightDrift:
    """What `looks` at the ground with `links` between them say, metres: how far apart two looks at the same ground lie
    at most by the poses as given, and those of one visit; how far they still do with the corrections (the 95th
    centile); how far the corrections span, and how far was driven. `is_followed`: the poses were corrected."""

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
        """Whether they lie farther apart than terrain and noise explain."""
        return self.apart_m > TOLERATED_M

    @property
    def is_followable(self) -> bool:
        """Whether it is slow enough to be drift, and gone with the corrections."""
        return self.visit_apart_m <= MOST_APART_M and self.left_m <= TOLERATED_M
