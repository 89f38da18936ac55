"""Why a recording cannot be synchronised: no LiDAR, no pose source, or no time in which both speak.

**Conventions.** TOP-1xx is about which topics there are, SYN-5xx about what they amount to together. Each sentence says
what was found and what to do.
"""

from collections.abc import Sequence

from stone.errors import StoneError
from stone_recordings.messages.lidars.models import topic_instead

SHOWN = 6
# Less is no other clock; of more, --time-offset says that it is a slip of the unit.
LEAST_APART_S, LAST_TRIED_S = 0.5, 1000.0


def listed(names: Sequence[str]) -> str:
    """The first names, and how many more."""
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return (", ".join(names[:SHOWN]) + more) or "none"


class NoLidarError(StoneError):
    """No topic holds the sweeps of a LiDAR."""

    code = "TOP-101"

    def __init__(self, packets: Sequence[tuple[str, str]]) -> None:
        cause = (
            f"{listed([name for name, _ in packets])} holds raw packets: {topic_instead(packets[0][1])}"
            if packets
            else "name its topic with --lidar if a cloud was taken for a radar's"
        )
        super().__init__(
            f"no LiDAR sensor_msgs/msg/PointCloud2 was recorded, nor packets that are decoded here; {cause}"
        )


class WrongTopicError(StoneError):
    """The topic that was asked for has no messages, or none of a type that can serve."""

    code = "TOP-104"

    def __init__(self, topic: str, found: str, expected: str) -> None:
        super().__init__(f"topic {topic!r} {found}; expected {expected}")


class AmbiguousTopicsError(StoneError):
    """Several topics fit one role, and none was chosen."""

    code = "TOP-110"

    def __init__(self, role: str, topics: Sequence[str], option: str) -> None:
        super().__init__(f"{len(topics)} topics fit the role {role}: {listed(topics)}; choose one with {option}")


class NoPoseSourceError(StoneError):
    """The recording has no pose source."""

    code = "SYN-502"

    def __init__(self, found: Sequence[str]) -> None:
        super().__init__(
            "no pose source: no NovAtel INSPVA(X), no nav_msgs/msg/Odometry, no /tf from odom, map or world to the "
            f"robot, no PoseStamped and no NavSatFix with an Imu (found: {listed(found)}); record one, name a topic "
            "with --odometry, give a file with --poses, or estimate them from the sweeps: --odometry kiss-icp"
        )


class NoUsablePoseError(StoneError):
    """There is a pose source, but none of its samples is usable."""

    code = "SYN-503"

    def __init__(self, source: str, count: int, why: str) -> None:
        super().__init__(
            f"{source}: none of its {count} samples is usable ({why}); was it initialised while recording?"
        )


class NoAttitudeError(StoneError):
    """The IMU beside a receiver gives no orientation."""

    code = "GNS-306"

    def __init__(self, topic: str, count: int) -> None:
        super().__init__(
            f"{topic}: none of its {count} messages gives an orientation (orientation_covariance[0] is -1, or no "
            "rotation), so positions of NavSatFix alone are not poses; record the filtered IMU (imu_filter_madgwick, "
            "the driver's /imu/data), or estimate them from the sweeps: --odometry kiss-icp"
        )


class PoseFileError(StoneError):
    """A file of poses has a line that is not a pose."""

    code = "SYN-516"

    def __init__(self, name: str, line: int, fault: str) -> None:
        where = f"{name}, line {line}" if line else name
        super().__init__(f"{where}: {fault}; a line is `time x y z qx qy qz qw` (TUM) or a 3 × 4 matrix (KITTI)")


class PoseFileMismatchError(StoneError):
    """A file of poses does not match the recording or its calibration."""

    code = "SYN-517"

    def __init__(self, name: str, fault: str) -> None:
        super().__init__(f"{name}: {fault}")


class NoUsableSweepError(StoneError):
    """None of the LiDAR's sweeps can be used."""

    code = "SYN-509"

    def __init__(self, topic: str, count: int, reason: str) -> None:
        super().__init__(f"{topic}: none of its {count} sweeps can be used (the first: {reason}); check the driver")


class StillPosesError(StoneError):
    """The poses do not move although the sweeps do."""

    code = "SYN-510"

    def __init__(self, source: str, count: int, moved_m: float) -> None:
        super().__init__(
            f"{source}: its {count} poses never change, but the sweeps show {moved_m:.1f} m of motion; was the source "
            "initialised? Choose another one, or estimate them from the sweeps: --odometry kiss-icp"
        )


class SparsePosesError(StoneError):
    """Poses are too sparse for any sweep to have one."""

    code = "SYN-511"

    def __init__(self, source: str, period_s: float, limit_s: float) -> None:
        super().__init__(
            f"{source}: its poses come every {period_s:.3f} s, and nothing is interpolated across more than "
            f"{limit_s:.3f} s, so no sweep has a pose; record them at a higher rate, or estimate them from the sweeps: "
            "--odometry kiss-icp"
        )


class NoPosedFramesError(StoneError):
    """No LiDAR stamp has a pose."""

    code = "SYN-501"

    def __init__(self, reasons: str, lidar_s: tuple[float, float], poses_s: tuple[float, float]) -> None:
        apart_s = lidar_s[0] - poses_s[0]
        super().__init__(
            f"no sweep is usable ({reasons}): LiDAR stamps run from {lidar_s[0]:.3f} to {lidar_s[1]:.3f} s, poses from "
            f"{poses_s[0]:.3f} to {poses_s[1]:.3f} s, {apart_s:+.3f} s apart at the start (18 s is GPS, 37 s TAI, "
            f"hours a time zone{_way_out(apart_s)}; for pose_gap, record poses more often, or estimate them "
            "from the sweeps: "
            "--odometry kiss-icp)"
        )


def _way_out(apart_s: float) -> str:
    """How to bring two clocks together that are so far apart."""
    if abs(apart_s) < LEAST_APART_S:
        return ""
    is_tried = abs(apart_s) <= LAST_TRIED_S
    way = f"--time-offset pose={apart_s:.3f}s tries that" if is_tried else "set time_offset_ns in the calibration"
    return f": {way}"
