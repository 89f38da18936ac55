"""Refusals of synchronisation: no LiDAR, no pose source, or no time that both cover.

**Conventions.** TOP-1xx is about single topics, SYN-5xx about topics in combination. Each sentence contains the value
and the remedy.
"""

from collections.abc import Sequence

from stone.errors import Refused, StoneError

SHOWN = 6


def listed(names: Sequence[str]) -> str:
    """Return the first names, and the number of the rest."""
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return (", ".join(names[:SHOWN]) + more) or "none"


def no_lidar(unread: str) -> Refused:
    """Return the refusal TOP-101; `unread` names the topics that may hold points and are not read."""
    cause = unread or "name its topic with --lidar if a cloud was taken for a radar's"
    return Refused(
        "TOP-101",
        "the recording has no LiDAR sensor_msgs/msg/PointCloud2, nor other points or packets that can be decoded; "
        f"{cause}",
    )


def ambiguous_topics(role: str, topics: Sequence[str], option: str) -> Refused:
    return Refused("TOP-110", f"{len(topics)} topics fit the role {role}: {listed(topics)}; choose one with {option}")


def no_pose_source(found: Sequence[str]) -> Refused:
    return Refused(
        "SYN-502",
        "the recording has no pose source: no NovAtel INSPVA(X), nav_msgs/msg/Odometry, PoseStamped, NavSatFix with an "
        f"Imu, or /tf from odom, map or world to the robot (found: {listed(found)}). Record a source, name a topic "
        "with "
        "--odometry, give a file with --poses, or estimate the poses from the sweeps: --odometry kiss-icp",
    )


class NoUsablePoseError(StoneError):
    """There is a pose source, but none of its samples is usable."""

    code = "SYN-503"

    def __init__(self, source: str, count: int, why: str) -> None:
        super().__init__(
            f"{source}: none of its {count} samples is usable ({why}). Initialise the source before recording, or "
            "choose another"
        )


def no_posed_frames(reasons: str, lidar_s: tuple[float, float], poses_s: tuple[float, float], way_out: str) -> Refused:
    apart_s = lidar_s[0] - poses_s[0]
    return Refused(
        "SYN-501",
        f"no sweep is usable ({reasons}). LiDAR stamps run from {lidar_s[0]:.3f} to {lidar_s[1]:.3f} s, poses from "
        f"{poses_s[0]:.3f} to {poses_s[1]:.3f} s, {apart_s:+.3f} s apart at the start. 18 s indicate GPS time, 37 s "
        f"TAI, hours a time zone{way_out}. For pose_gap, record poses more often, or estimate them "
        "from the sweeps: "
        "--odometry kiss-icp)",
    )
