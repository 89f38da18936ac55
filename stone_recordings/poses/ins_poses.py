"""The ego trajectory from a NovAtel INS: local ENU metres, the receiver's time, the lever arm rotated with the robot.

    map_from_ego = map_from_ins @ (ego_from_lidar @ lidar_from_ins)⁻¹

**Conventions.** `map` is east, north, up around the first usable solution (WGS 84, ellipsoidal height). The INS frame
of the calibration is x forward, y left, z up: the driver's rule setRPY(roll, −pitch, 90° − azimuth). Stamps are rebuilt
from GPS week and milliseconds; the driver's header stamps are the host's publish times. The receiver's north and up are
those of each point; they are turned to those of the origin, 0.009° a kilometre away.
"""

from collections.abc import Iterable

import numpy as np
import pymap3d
from numpy.typing import NDArray

from stone.findings import Finding
from stone.geometry.se3 import SE3, multiply
from stone.geometry.trajectory import Trajectory
from stone.sensors.calibration import Calibration, Mount
from stone.sensors.calibration_errors import MissingSensorError
from stone_recordings.clocks.host_stamps import GPS_REMEDY, host_stamp_finding, lateness
from stone_recordings.messages.batch import MOST_POSITION_M, StampedMessage
from stone_recordings.messages.novatel import (
    INS_ALIGNMENT_COMPLETE,
    INS_SOLUTION_FREE,
    INS_SOLUTION_GOOD,
    FixSamples,
    InsSamples,
    decode_inspva,
)
from stone_recordings.messages.problems import read_readable
from stone_recordings.poses.places import near_geodetic
from stone_recordings.poses.quality import solution_quality
from stone_recordings.poses.sources import PoseTrack
from stone_recordings.sync.clock_offsets import shifted_finding
from stone_recordings.sync.errors import NoUsablePoseError
from stone_recordings.sync.recorded_messages import in_order

USABLE_STATUS = (INS_SOLUTION_GOOD, INS_SOLUTION_FREE, INS_ALIGNMENT_COMPLETE)


def track_from_ins(
    messages: Iterable[StampedMessage],
    topic: str,
    calibration: Calibration,
    fixes: FixSamples | None,
    offset_ns: int | None = None,
) -> PoseTrack:
    """Return the track; `offset_ns` is added to the stamps and replaces the calibration's offset.

    Raises MissingSensorError (no INS in the calibration), NoUsablePoseError, and the errors of `decode_inspva`.
    """
    mount = _ins_mount(calibration)
    samples, unread = read_readable(topic, messages, decode_inspva)
    source = f"{topic} (novatel_oem7_msgs/msg/{'INSPVA' if samples.pos_type is None else 'INSPVAX'})"
    rows = _usable(samples, source)
    usable = len(rows)  # far samples are counted apart
    ordered = in_order(topic, samples.gps_stamps_ns[rows])
    position = (samples.latitude_deg[rows], samples.longitude_deg[rows], samples.height_m[rows])
    ordered, far = near_geodetic(topic, ordered, position)
    rows = rows[ordered.index]
    map_from_ins, origin = enu_poses(samples, rows)
    ins_from_ego = (calibration.ego_from_lidar @ mount.lidar_from_sensor).inverse()
    offset_ns = mount.time_offset_ns if offset_ns is None else offset_ns
    trajectory = Trajectory(ordered.stamps_ns + offset_ns, map_from_ins @ ins_from_ego)
    solution = solution_quality(samples, rows, fixes)
    findings = (
        unread
        + ordered.findings
        + far
        + shifted_finding(topic, offset_ns)
        + _clock(samples, topic)
        + _left_out(samples, usable, topic)
    )
    if not solution.rtk.any():
        findings += (Finding("GNS-301", "warning", topic, "the RTK status is unknown (no BESTPOS)"),)
    return PoseTrack(trajectory, source, topic, findings, origin, solution, is_smooth=True)


def enu_poses(samples: InsSamples, rows: NDArray[np.int64]) -> tuple[SE3, tuple[float, float, float]]:
    """Return `map_from_ins` (N,) at `rows`, and the map's origin: the first of them."""
    latitude, longitude, height = (
        values[rows] for values in (samples.latitude_deg, samples.longitude_deg, samples.height_m)
    )
    origin = (float(latitude[0]), float(longitude[0]), float(height[0]))
    position_m = np.stack(pymap3d.geodetic2enu(latitude, longitude, height, *origin), axis=-1)
    body = enu_from_body_wxyz(samples.roll_deg[rows], samples.pitch_deg[rows], samples.azimuth_deg[rows])
    there = ecef_from_enu_wxyz(latitude, longitude)
    back = there[:1] * np.array([1.0, -1.0, -1.0, -1.0])
    return SE3.from_parts(multiply(multiply(back, there), body), position_m), origin


def enu_from_body_wxyz(
    roll_deg: NDArray[np.float64], pitch_deg: NDArray[np.float64], azimuth_deg: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return quaternions (N, 4) of Rz(90° − azimuth) Ry(−pitch) Rx(roll): east, north, up from forward, left, up."""
    yaw = _about(2, np.deg2rad(90.0 - azimuth_deg))
    return multiply(multiply(yaw, _about(1, np.deg2rad(-pitch_deg))), _about(0, np.deg2rad(roll_deg)))


def ecef_from_enu_wxyz(latitude_deg: NDArray[np.float64], longitude_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return quaternions (N, 4) of Rz(90° + longitude) Rx(90° − latitude)."""
    return multiply(_about(2, np.deg2rad(90.0 + longitude_deg)), _about(0, np.deg2rad(90.0 - latitude_deg)))


def _about(axis: int, angle_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    wxyz = np.zeros((*angle_rad.shape, 4))
    wxyz[..., 0], wxyz[..., 1 + axis] = np.cos(angle_rad / 2), np.sin(angle_rad / 2)
    return wxyz


def _ins_mount(calibration: Calibration) -> Mount:
    mounts = calibration.of_kind("ins")
    if not mounts:
        raise MissingSensorError(["INS"], [mount.name for mount in calibration.mounts], "the recorded INS pose")
    return mounts[0]


def _usable(samples: InsSamples, source: str) -> NDArray[np.int64]:
    """Return the rows with a solution, a time, a place on Earth and a valid attitude."""
    position = (samples.latitude_deg, samples.longitude_deg, samples.height_m)
    attitude = (samples.roll_deg, samples.pitch_deg, samples.azimuth_deg)
    has_numbers = np.isfinite(np.stack([*position, *attitude])).all(axis=0) & (np.abs(samples.latitude_deg) <= 90)
    has_numbers &= np.abs(samples.height_m) <= MOST_POSITION_M
    has_solution, has_time = np.isin(samples.ins_status, USABLE_STATUS), samples.gps_stamps_ns > 0
    rows = np.flatnonzero(has_numbers & has_solution & has_time).astype(np.int64)
    if not len(rows):
        why = (
            f"{int((~has_solution).sum())} without an aligned solution, {int((~has_time).sum())} without GPS time, "
            f"{int((~has_numbers).sum())} with impossible numbers"
        )
        raise NoUsablePoseError(source, len(samples.ins_status), why)
    return rows


def _clock(samples: InsSamples, topic: str) -> tuple[Finding, ...]:
    """Return the finding on the clock, over all messages with GPS time, as an inspection counts them."""
    has_time = samples.gps_stamps_ns > 0
    late = lateness(samples.host_stamps_ns[has_time] - samples.gps_stamps_ns[has_time])
    return (host_stamp_finding(topic, late, GPS_REMEDY),) if late is not None and late.is_host else ()


def _left_out(samples: InsSamples, used: int, topic: str) -> tuple[Finding, ...]:
    total = len(samples.ins_status)
    if used == total:
        return ()
    sentence = f"{total - used} of {total} samples had no solution and are left out"
    return (Finding("GNS-303", "warning", topic, sentence),)
