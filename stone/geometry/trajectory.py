"""Poses interpolated in time: position linearly, orientation by slerp, never extrapolated.

**Conventions.** Poses are `map_from_ego` at strictly increasing int64 `stamps_ns`. A query at a pose's own stamp
returns that pose. A query between two poses has a result only if they are at most `max_gap_ns` apart and in one segment
(a track is split where its source jumped, `stone.geometry.jumps`). Queries outside the first and last pose have no
result. Missing results are NaN with a status that gives the reason, so they cannot be used by mistake.

The linear position error is at most a·dt²/8: 0.9 mm at 20 Hz and 3 m/s², 2.3 cm at the default 250 ms. Source: paper,
III-C.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from stone.errors import Refused, ShapeError
from stone.geometry.se3 import SE3, interpolate

DEFAULT_MAX_GAP_NS = 250_000_000


class PoseStatus(IntEnum):
    """Whether a query has a pose, or why not."""

    OK = 0
    BEFORE_FIRST = 1
    AFTER_LAST = 2
    GAP = 3
    SPLIT = 4


@dataclass(frozen=True, eq=False)
class Interpolated:
    """N results: `map_from_ego` (NaN unless ok), `gap_ns` (N,) int64 and `status` (N,) uint8 of PoseStatus.

    `gap_ns` is the interval between the two poses around the query; 0 at a pose's own stamp and outside all poses.
    `segment` (N,) is the segment of the previous pose; results of different segments must not be related to each other.
    """

    map_from_ego: SE3
    gap_ns: NDArray[np.int64]
    status: NDArray[np.uint8]
    segment: NDArray[np.int64]

    @property
    def is_ok(self) -> NDArray[np.bool_]:
        return np.equal(self.status, PoseStatus.OK)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """`map_from_ego` (K,) at `stamps_ns` (K,), K ≥ 1; `segment` (K,) numbers the unbroken stretches, None for one
    stretch.

    Raises `empty_trajectory`, `trajectory_stamps`, and ShapeError if the lengths differ.
    """

    stamps_ns: NDArray[np.int64]
    map_from_ego: SE3
    segment: NDArray[np.int64] | None = None

    def __post_init__(self) -> None:
        if self.stamps_ns.ndim != 1 or self.map_from_ego.batch != self.stamps_ns.shape:
            raise ShapeError("map_from_ego", self.map_from_ego.batch, f"one pose per stamp {self.stamps_ns.shape}")
        if self.segment is not None and self.segment.shape != self.stamps_ns.shape:
            raise ShapeError("segment", self.segment.shape, f"one number per stamp {self.stamps_ns.shape}")
        if self.stamps_ns.size == 0:
            raise Refused(
                "empty_trajectory",
                "a trajectory has 0 poses; at least 1 is required (did the pose topic record anything?)",
            )
        steps_ns = np.diff(self.stamps_ns)
        if steps_ns.size and steps_ns.min() <= 0:
            at = int(np.argmax(steps_ns <= 0))
            raise Refused(
                "trajectory_stamps",
                f"pose {at + 1} is {int(steps_ns[at])} ns after the previous pose; stamps of a trajectory must "
                "strictly increase (sort them, remove repeats)",
            )

    def __len__(self) -> int:
        return int(self.stamps_ns.size)

    @property
    def segments(self) -> NDArray[np.int64]:
        """The segment (K,) of every pose."""
        return np.zeros(len(self), np.int64) if self.segment is None else self.segment

    def around(self, query_ns: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the poses (left, right) around each query (N,): one pose twice at its own stamp and outside all
        poses.
        """
        left = np.clip(np.searchsorted(self.stamps_ns, query_ns, side="right") - 1, 0, len(self) - 1)
        is_alone = (self.stamps_ns[left] == query_ns) | (query_ns < self.stamps_ns[0])
        right = np.where(is_alone, left, np.minimum(left + 1, len(self) - 1))
        return left.astype(np.int64), right.astype(np.int64)

    def at(self, query_ns: NDArray[np.int64], max_gap_ns: int = DEFAULT_MAX_GAP_NS) -> Interpolated:
        """Return the poses at `query_ns` (N,), in any order; a gap of exactly `max_gap_ns` is still bridged."""
        stamps_ns = self.stamps_ns
        left, right = self.around(query_ns)
        gap_ns = stamps_ns[right] - stamps_ns[left]
        segment = self.segments
        choices = [
            (query_ns < stamps_ns[0], PoseStatus.BEFORE_FIRST),
            (query_ns > stamps_ns[-1], PoseStatus.AFTER_LAST),
            (gap_ns > max_gap_ns, PoseStatus.GAP),
            (segment[left] != segment[right], PoseStatus.SPLIT),
        ]
        status = np.select([claim for claim, _ in choices], [code for _, code in choices], PoseStatus.OK)
        ratio = np.where(status == PoseStatus.OK, (query_ns - stamps_ns[left]) / np.maximum(gap_ns, 1), np.nan)
        poses = interpolate(self.map_from_ego[left], self.map_from_ego[right], ratio)
        return Interpolated(poses, gap_ns, status.astype(np.uint8), segment[left])
