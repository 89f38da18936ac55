"""The quality of the poses of an INS: RTK status and standard deviations, by INSPVAX itself, else by BESTPOS.

**Conventions.** An INSPVA contains no quality; the last BESTPOS before it counts for half a second: the receiver logs
positions at 5 Hz at most while the INS runs. Source: NovAtel OEM7 manual, "Position or Velocity Type".
"""

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone.geometry.trajectory import Trajectory
from stone.sensors.driving_direction import driving_direction
from stone.sensors.pose_quality import PoseQuality, Rtk, SolutionQuality, unknown_quality
from stone_recordings.messages.novatel import FixSamples, InsSamples

HOLD_NS = 500_000_000
RTK_OF_TYPE = {
    0: Rtk.NONE,
    **dict.fromkeys((1, 2, 8, 16, 19, 53, 70, 71, 72), Rtk.SINGLE),
    **dict.fromkeys((17, 18, 20, 52, 54, 68, 69, 73, 74, 77, 78, 79, 80), Rtk.DIFFERENTIAL),
    **dict.fromkeys((32, 33, 34, 55), Rtk.FLOAT),
    **dict.fromkeys((48, 49, 50, 51, 56), Rtk.FIXED),
}
STDEV_LIMIT_M = 0.10
RTK_SHARE_USUAL = 0.95
LEAST_ASIDE_M = 0.03  # sound drives, simulated and analytic, deviate by at most 0.01 m, KITTI's odometry by 0.02 m


def solution_quality(samples: InsSamples, rows: NDArray[np.int64], fixes: FixSamples | None) -> SolutionQuality:
    """Return the quality of the samples at `rows` (K,), in their order."""
    if samples.pos_type is not None and samples.position_stdev_m is not None:
        return SolutionQuality(rtk_of(samples.pos_type[rows]), _east_north_up(samples.position_stdev_m[rows]))
    if fixes is None or not len(fixes.pos_type):
        return unknown_quality(len(rows))
    return _held(samples.gps_stamps_ns[rows], fixes)


def rtk_of(pos_type: NDArray[np.uint32]) -> NDArray[np.uint8]:
    """Return NovAtel's position types (K,) as `Rtk`; UNKNOWN for a type that no manual lists."""
    table = np.full(max(RTK_OF_TYPE) + 2, Rtk.UNKNOWN, np.uint8)
    table[list(RTK_OF_TYPE)] = list(RTK_OF_TYPE.values())
    return np.asarray(table[np.minimum(pos_type, len(table) - 1)], dtype=np.uint8)


def quality_findings(
    topic: str, quality: PoseQuality | None, solution: SolutionQuality | None, path: Trajectory
) -> tuple[Finding, ...]:
    """Return findings about the reliability of the frames' poses; none for a source without a status."""
    if quality is None or solution is None:
        return ()
    findings = []
    is_known = solution.rtk != Rtk.UNKNOWN
    share = float((solution.rtk[is_known] == Rtk.FIXED).mean()) if is_known.any() else 1.0
    if share < RTK_SHARE_USUAL:
        floating = float((solution.rtk[is_known] == Rtk.FLOAT).mean())
        sentence = f"RTK was fixed only {share * 100:.1f} % of the time ({floating * 100:.1f} % float){_wander(path)}"
        findings.append(Finding("GNS-301", "warning", topic, sentence))
    worst_m = np.max(quality.stdev_m, axis=1, initial=0.0)
    is_doubtful = worst_m > STDEV_LIMIT_M
    if is_doubtful.any():
        sentence = (
            f"{int(is_doubtful.sum())} of {len(worst_m)} frames have a position stdev above {STDEV_LIMIT_M:g} m "
            f"(worst {worst_m.max():.3f} m)"
        )
        findings.append(Finding("GNS-304", "warning", topic, sentence))
    return tuple(findings)


def _wander(path: Trajectory) -> str:
    """Return the lateral deviation of the poses in plan, if it exceeds that of a sound run; else ""."""
    direction = driving_direction(path)
    if direction is None or direction.aside_m < LEAST_ASIDE_M:
        return ""
    plan_cm = 100.0 * direction.aside_m * np.sqrt(2.0)
    return (
        f"; the poses deviate sideways from the robot's heading by {100.0 * direction.aside_m:.0f} cm (standard "
        f"deviation over 20 m), which is about {plan_cm:.0f} cm in plan"
    )


def _held(stamps_ns: NDArray[np.int64], fixes: FixSamples) -> SolutionQuality:
    """Return the last fix at or before each stamp, for as long as it is valid."""
    order = np.argsort(fixes.gps_stamps_ns, kind="stable")
    fix_ns = fixes.gps_stamps_ns[order]
    before = np.searchsorted(fix_ns, stamps_ns, side="right") - 1
    rows = order[np.maximum(before, 0)]
    is_held = (before >= 0) & (stamps_ns - fix_ns[np.maximum(before, 0)] <= HOLD_NS)
    stdev_m = _east_north_up(fixes.position_stdev_m[rows])
    return SolutionQuality(
        np.where(is_held, rtk_of(fixes.pos_type[rows]), np.uint8(Rtk.UNKNOWN)),
        np.where(is_held[:, None], stdev_m, np.nan),
    )


def _east_north_up(along_latitude_longitude_height: NDArray[np.float64]) -> NDArray[np.float64]:
    """Reorder latitude, longitude, height (NovAtel) as east, north, up; invalid deviations (negative, infinite) become
    NaN.
    """
    stdev_m = along_latitude_longitude_height[:, [1, 0, 2]]
    return np.where(np.isfinite(stdev_m) & (stdev_m >= 0), stdev_m, np.nan)
