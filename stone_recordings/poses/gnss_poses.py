"""The ego trajectory from a receiver's positions and an IMU's attitude: sensor_msgs/NavSatFix and Imu.

    position_map_ego = position_map_antenna − R_map_ego · position_ego_antenna,   R_map_ego = R_map_imu · R_imu_ego

**Conventions.** `map` is east, north, up within a metre of the first position (WGS 84, ellipsoidal height). There is
one pose per fix, its attitude by slerp between the IMU's. The IMU's orientation counts as one in east, north, up (REP
103), not as relative to the orientation at power-on: the messages do not distinguish the two.
"""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import pymap3d
from numpy.typing import NDArray

from stone.errors import Refused
from stone.findings import Finding
from stone.geometry.se3 import SE3, multiply
from stone.geometry.trajectory import DEFAULT_MAX_GAP_NS, Trajectory
from stone_recordings.bags.errors import ByteOrderError, MessageLayoutError
from stone_recordings.messages.batch import MOST_POSITION_M, StampedMessage
from stone_recordings.messages.gnss import NAVSATFIX, GnssSamples, decode_gnss
from stone_recordings.messages.imu import AttitudeSamples, decode_attitude
from stone_recordings.messages.problems import read_readable
from stone_recordings.messages.types.cdr import Cursor
from stone_recordings.poses.ins_poses import ecef_from_enu_wxyz
from stone_recordings.poses.places import lattice_origin, near_geodetic
from stone_recordings.poses.sources import PoseTrack, RigMounts, along_course, child_from_ego, course_finding
from stone_recordings.sync.clock_offsets import shifted_finding
from stone_recordings.sync.errors import NoUsablePoseError
from stone_recordings.sync.recorded_messages import in_order

ENU = "enu"


@dataclass(frozen=True, eq=False)
class GnssTopics:
    """Messages of the receiver and of the IMU, with the names of their topics."""

    fixes: Iterable[StampedMessage]
    fix_topic: str
    fix_frame: str
    imu: Iterable[StampedMessage] = ()
    imu_topic: str = ""


def track_from_gnss(topics: GnssTopics, rig: RigMounts) -> PoseTrack:
    """Return the track with an IMU's attitude, or with the course over ground if `rig.is_course`.

    Raises NoUsablePoseError (no position, or none while there is an attitude), `GNS-306`, and the decoding errors.
    """
    topic = topics.fix_topic
    samples, unread = read_readable(topic, topics.fixes, lambda some: decode_gnss(NAVSATFIX, some))
    by = "course over ground" if rig.is_course else topics.imu_topic
    source = f"{topic} with {by} (sensor_msgs/msg/NavSatFix{'' if rig.is_course else ' and Imu'})"
    ordered = in_order(topic, samples.stamps_ns, _positions(samples, source))
    fixed, far = near_geodetic(topic, ordered, (samples.latitude_deg, samples.longitude_deg, samples.height_m))
    antenna_from_ego, of_antenna = child_from_ego(ENU, topics.fix_frame, rig)
    if rig.is_course:
        at, (antenna_m, origin, _) = fixed.index, _enu(samples, fixed.index)
        poses = along_course(source, antenna_m, antenna_from_ego)
        reported: tuple[Finding, ...] = (course_finding(topic),)
    else:
        attitude, unread_too = read_readable(topics.imu_topic, topics.imu, decode_attitude)
        turns, findings = _attitudes(topics, attitude)
        interpolated = turns.at(fixed.stamps_ns, DEFAULT_MAX_GAP_NS)
        if not interpolated.is_ok.any():
            why = f"none has an attitude within {DEFAULT_MAX_GAP_NS / 1e9:g} s"
            raise NoUsablePoseError(source, len(fixed.index), why)
        imu_from_ego, of_imu = child_from_ego(ENU, attitude.frame_id, rig)
        at = fixed.index[interpolated.is_ok]
        antenna_m, origin, to_origin = _enu(samples, at)
        imu_wxyz = multiply(to_origin, interpolated.map_from_ego.wxyz[interpolated.is_ok])
        turned = SE3.from_parts(imu_wxyz, np.zeros((len(at), 3))) @ SE3.from_parts(imu_from_ego.wxyz, np.zeros(3))
        poses = SE3.from_parts(turned.wxyz, antenna_m - turned @ antenna_from_ego.inverse().translation_m)
        reported = (*unread_too, *findings, *of_imu)
    offset_ns = rig.clocks.of_poses(rig.calibration, topics.fix_frame)
    reported = (*unread, *fixed.findings, *far, *reported, *of_antenna, *shifted_finding(topic, offset_ns))
    reported += _left_out(samples, len(at) + len(ordered.index) - len(fixed.index), topic)
    trajectory = Trajectory(samples.stamps_ns[at] + offset_ns, poses)
    return PoseTrack(trajectory, source, topic, reported, origin, is_course=rig.is_course)


def first_frame_id(messages: Sequence[StampedMessage], type_name: str) -> str:
    """Return the frame of the first message with a readable header; "" without."""
    for message in messages:
        with suppress(MessageLayoutError, ByteOrderError):
            cursor = Cursor(message.payload, type_name)
            cursor.stamp_ns()
            return cursor.text()
    return ""


def _positions(samples: GnssSamples, source: str) -> NDArray[np.int64]:
    """Return the rows that have a time and a place on Earth."""
    is_place = samples.is_fixed & (np.abs(samples.latitude_deg) <= 90) & (np.abs(samples.longitude_deg) <= 360)
    is_place &= np.abs(samples.height_m) <= MOST_POSITION_M
    rows = np.flatnonzero(is_place & (samples.stamps_ns != 0)).astype(np.int64)
    if not len(rows):
        why = f"{int((~samples.is_fixed).sum())} without a fix, {int((samples.stamps_ns == 0).sum())} stamped 0"
        raise NoUsablePoseError(source, len(samples.stamps_ns), why)
    return rows


def _attitudes(topics: GnssTopics, attitude: AttitudeSamples) -> tuple[Trajectory, tuple[Finding, ...]]:
    """Return the orientations as poses without a position. Raises `GNS-306` if the IMU gives none."""
    topic = topics.imu_topic
    rows = np.flatnonzero(attitude.is_told & (attitude.stamps_ns != 0)).astype(np.int64)
    if not len(rows):
        raise Refused(
            "GNS-306",
            f"{topic}: none of its {len(attitude.stamps_ns)} messages gives an orientation "
            "(orientation_covariance[0] is -1, or no rotation), and positions of NavSatFix alone are not poses. "
            "Record the filtered IMU (imu_filter_madgwick, the driver's /imu/data), or estimate poses from the sweeps: "
            "--odometry kiss-icp. If the robot always drives forward, use its course as heading: "
            f"--odometry course:{topics.fix_topic}",
        )
    ordered = in_order(topic, attitude.stamps_ns, rows)
    wxyz = attitude.enu_from_imu_xyzw[ordered.index][:, [3, 0, 1, 2]]
    return Trajectory(ordered.stamps_ns, SE3.from_parts(wxyz, np.zeros((len(wxyz), 3)))), ordered.findings


def _enu(
    samples: GnssSamples, rows: NDArray[np.int64]
) -> tuple[NDArray[np.float64], tuple[float, float, float], NDArray[np.float64]]:
    """Return positions (N, 3) around the map's origin, the origin, and turns (N, 4) from each point's north to the
    first's.
    """
    latitude, longitude, height = (
        values[rows] for values in (samples.latitude_deg, samples.longitude_deg, samples.height_m)
    )
    origin = lattice_origin(float(latitude[0]), float(longitude[0]), float(height[0]))
    there = ecef_from_enu_wxyz(latitude, longitude)
    back = there[:1] * np.array([1.0, -1.0, -1.0, -1.0])
    place_m = np.stack(pymap3d.geodetic2enu(latitude, longitude, height, *origin), axis=-1)
    return place_m, origin, multiply(back, there)


def _left_out(samples: GnssSamples, used: int, topic: str) -> tuple[Finding, ...]:
    unknown = Finding("GNS-301", "warning", topic, "the RTK status is unknown (NavSatFix has none)")
    total = len(samples.stamps_ns)
    if used == total:
        return (unknown,)
    sentence = f"{total - used} of {total} positions had no fix or no attitude and are left out"
    return (unknown, Finding("GNS-303", "warning", topic, sentence))
