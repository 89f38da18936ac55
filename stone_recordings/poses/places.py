"""Positions as sources write them: outliers, UTM, ECEF, degrees; the map lies near its origin.

**Conventions.** Positions (N, 3) are metres in the order of time. UTM and any other frame with a distant origin is
shifted by whole metres, so that the voxels of the map stay in place. ECEF (WGS 84) is turned to east, north, up of the
first position. Positions that move smoothly by millionths are degrees, not metres.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pymap3d
from numpy.typing import NDArray

from stone.errors import Refused
from stone.findings import Finding
from stone.geometry.se3 import SE3, multiply, rotate
from stone.geometry.trajectory import Trajectory
from stone.sensors.course import aside_of_course
from stone_recordings.sync.recorded_messages import OrderedStamps

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
REACH_M, FASTEST_M_S = 100.0, 60.0
MOST_FAR, ONE_PLACE_M, MOST_AT_ONE_PLACE = 0.1, 1.0, 0.75
LOCAL_M, MAP_M = 10_000.0, 100_000.0  # the lattice of the map ends at 104.8 km
EARTH_M, EARTH_HEIGHTS_M, UTM_EASTING_M = (6.33e6, 6.41e6), (-1000.0, 10_000.0), (1e5, 9e5)
MOST_TILT_RAD, SURE_RAD = float(np.deg2rad(35.0)), float(np.deg2rad(10.0))
# One degree of latitude; a drive in degrees spans less than one and moves by less than a thousandth a second.
DEGREE_M, MOST_SPAN_DEG, LEAST_WAY_M, STEP_NS = 111_000.0, 1.0, 3.0, 500_000_000
MOST_BEND_RAD = float(np.deg2rad(45.0))


def is_near(stamps_ns: Stamps, place_m: Array) -> NDArray[np.bool_]:
    """Return which positions (N,) a vehicle can have reached from most of the others.

    Returns all if more than a tenth would be dropped and these lie in several places: then it is unclear which are
    right.
    """
    kept = np.ones(len(place_m), np.bool_)
    if not _leaps(stamps_ns, place_m).any():
        return kept
    usual = np.median(place_m, axis=0)
    still = np.linalg.norm(place_m - usual, axis=1) < ONE_PLACE_M
    if 0.5 <= still.mean() < MOST_AT_ONE_PLACE and not _is_one_place(place_m[~still]):
        usual = np.median(place_m[~still], axis=0)
    kept = _reached(stamps_ns, place_m, int(np.argmin(np.linalg.norm(place_m - usual, axis=1))))
    is_few = (~kept).mean() <= MOST_FAR or _is_one_place(place_m[~kept])
    return kept if is_few else np.ones(len(place_m), np.bool_)


def _leaps(stamps_ns: Stamps, place_m: Array) -> NDArray[np.bool_]:
    far_m = np.linalg.norm(np.diff(place_m, axis=0), axis=1)
    return np.asarray(far_m > REACH_M + FASTEST_M_S * np.diff(stamps_ns) * 1e-9)


def _is_one_place(place_m: Array) -> bool:
    return bool(np.linalg.norm(np.ptp(place_m, axis=0)) < ONE_PLACE_M) if len(place_m) else True


def _reached(stamps_ns: Stamps, place_m: Array, begin: int) -> NDArray[np.bool_]:
    """Return which positions are reachable from position `begin`, forwards and backwards in time."""
    kept = np.zeros(len(place_m), np.bool_)
    kept[begin] = True
    for way in (range(begin + 1, len(place_m)), range(begin - 1, -1, -1)):
        last = begin
        for row in way:
            far_m = float(np.linalg.norm(place_m[row] - place_m[last]))
            if far_m <= REACH_M + FASTEST_M_S * abs(int(stamps_ns[row] - stamps_ns[last])) * 1e-9:
                kept[row], last = True, row
    return kept


def far_finding(topic: str, place_m: Array, kept: NDArray[np.bool_]) -> tuple[Finding, ...]:
    """Return GNS-310 for positions (N, 3) that are not `kept`."""
    if kept.all():
        return ()
    far_m = np.linalg.norm(place_m[~kept] - np.median(place_m[kept], axis=0), axis=1).max()
    sentence = (
        f"{int((~kept).sum())} of {len(kept)} positions lie far from the others (up to {far_m / 1000:,.1f} km) and are "
        "left out"
    )
    return (Finding("GNS-310", "warning", topic, sentence),)


def near_geodetic(
    topic: str, ordered: OrderedStamps, place: tuple[Array, Array, Array]
) -> tuple[OrderedStamps, tuple[Finding, ...]]:
    """Return the stamps whose latitude, longitude (degrees) and height (N,) are of one track, and GNS-310 for others.

    A receiver without a solution writes zeros, for the position or for the height alone.
    """
    latitude, longitude, height_m = (values[ordered.index] for values in place)
    is_zero = (latitude == 0) & (longitude == 0)
    is_flat = (height_m == 0) & ~is_zero
    if is_flat.mean() < 0.5 and np.abs(np.median(height_m[~is_flat])) > 1.0:
        is_zero |= is_flat
    if is_zero.all():
        is_zero[:] = False
    ecef_m = np.stack(pymap3d.geodetic2ecef(latitude, longitude, height_m), axis=-1)
    kept = ~is_zero
    kept[kept] = is_near(ordered.stamps_ns[kept], ecef_m[kept])
    left = replace(ordered, index=ordered.index[kept], stamps_ns=ordered.stamps_ns[kept])
    return left, far_finding(topic, ecef_m, kept)


def lattice_origin(latitude: float, longitude: float, height_m: float) -> tuple[float, float, float]:
    """Return the point nearest to a fix that is whole metres from its hundredth of a degree, at a whole height.

    Runs at one site thereby share one lattice of voxels, whichever fix is the first.
    """
    east_m, north_m, _ = pymap3d.geodetic2enu(
        latitude, longitude, height_m, around := round(latitude, 2), beside := round(longitude, 2), height_m
    )
    near = pymap3d.enu2geodetic(round(float(east_m)), round(float(north_m)), 0.0, around, beside, height_m)
    return float(near[0]), float(near[1]), float(round(height_m))


class Local(NamedTuple):
    """A mask of the `kept` poses (N,), these poses near the origin of the map, and the findings."""

    kept: NDArray[np.bool_]
    poses: SE3
    findings: tuple[Finding, ...]


def local_poses(topic: str, stamps_ns: Stamps, poses: SE3, *, is_course: bool = False) -> Local:
    """Return poses (N,) as those of a map near its origin. Raises `SYN-533` for degrees, `SYN-534` for ECEF whose
    attitude fits no ground; with `is_course` no attitude is needed.
    """
    refuse_degrees(topic, stamps_ns, poses)
    kept = is_near(stamps_ns, poses.translation_m)
    far = far_finding(topic, poses.translation_m, kept)
    if not kept.all():
        stamps_ns, poses = stamps_ns[kept], poses[kept]
    if np.abs(poses.translation_m).max() <= LOCAL_M:
        return Local(kept, poses, far)
    if _is_ecef(poses.translation_m):
        poses, finding = _from_ecef(topic, stamps_ns, poses, is_course)
        return Local(kept, poses, (*far, finding))
    origin_m = np.round(poses.translation_m[0]) + 0.0  # no −0
    sentence = (
        f"its positions are far from the origin of their frame; ({_listed(origin_m)}) m was subtracted and is the "
        "map's "
        "origin"
    )
    shifted = SE3.from_parts(poses.wxyz, poses.translation_m - origin_m)
    return Local(kept, shifted, (*far, Finding("SYN-532", "info", topic, sentence)))


def _listed(place_m: Array) -> str:
    return ", ".join(f"{value:.0f}" for value in place_m.tolist())


def _is_ecef(place_m: Array) -> bool:
    """Return whether positions lie on the ellipsoid, and are not UTM of the same magnitude."""
    away_m = np.linalg.norm(place_m, axis=1)
    if away_m.min() < EARTH_M[0] or away_m.max() > EARTH_M[1]:
        return False
    height_m = pymap3d.ecef2geodetic(*place_m.T)[2]
    is_high = height_m.min() < EARTH_HEIGHTS_M[0] or height_m.max() > EARTH_HEIGHTS_M[1]
    x_m, z_m = place_m[:, 0], np.abs(place_m[:, 2])
    is_utm = z_m.max() < EARTH_HEIGHTS_M[1] and x_m.min() > UTM_EASTING_M[0] and x_m.max() < UTM_EASTING_M[1]
    return not (is_high or is_utm)


def _from_ecef(topic: str, stamps_ns: Stamps, poses: SE3, is_course: bool) -> tuple[SE3, Finding]:
    first_m = poses.translation_m[0]
    latitude, longitude, height_m = lattice_origin(*(float(value) for value in pymap3d.ecef2geodetic(*first_m)))
    place_m = np.stack(pymap3d.ecef2enu(*poses.translation_m.T, latitude, longitude, height_m), axis=-1)
    about_z, about_x = np.deg2rad(90.0 + longitude) / 2, np.deg2rad(90.0 - latitude) / 2
    ecef_from_enu = multiply(
        np.array([np.cos(about_z), 0.0, 0.0, np.sin(about_z)]), np.array([np.cos(about_x), np.sin(about_x), 0.0, 0.0])
    )
    turned = SE3.from_parts(multiply(ecef_from_enu * np.array([1.0, -1.0, -1.0, -1.0]), poses.wxyz), place_m)
    choices = {"ECEF": turned, "east, north, up": SE3.from_parts(poses.wxyz, place_m)}
    words = "ECEF" if is_course else _attitude_frame(topic, stamps_ns, choices)
    sentence = (
        f"its positions are ECEF; the map is east, north, up near the first position, ({_listed(first_m)}) m, latitude "
        f"{latitude:.7f}°, longitude {longitude:.7f}°, height {height_m:.2f} m. Its orientation counts as given in "
        f"{words}, in which the robot is upright"
    )
    return choices[words], Finding("SYN-532", "info", topic, sentence)


def _attitude_frame(topic: str, stamps_ns: Stamps, choices: dict[str, SE3]) -> str:
    """Return the frame in which the robot is upright and, if it is upright in both, faces its course."""
    tilt = {words: _tilt_rad(poses) for words, poses in choices.items()}
    upright = [words for words in choices if tilt[words] <= MOST_TILT_RAD]
    if len(upright) > 1 and abs(tilt[upright[0]] - tilt[upright[1]]) < SURE_RAD:
        aside = {words: aside_of_course(Trajectory(stamps_ns, choices[words])) for words in upright}
        return min(upright, key=lambda words: aside[words])
    if upright:
        return min(upright, key=lambda words: tilt[words])
    degrees = " and ".join(f"{np.rad2deg(tilt[words]):.0f}° in {words}" for words in choices)
    raise Refused(
        "SYN-534",
        f"{topic}: its positions are ECEF, but its orientation tilts the robot by {degrees}, so its frame is unknown. "
        "Record "
        f"the poses in UTM or in a local frame, or use the course as heading: --odometry course:{topic}",
    )


def _tilt_rad(poses: SE3) -> float:
    up = rotate(poses.wxyz, np.array([0.0, 0.0, 1.0]))[:, 2]
    return float(np.median(np.arccos(np.clip(up, -1.0, 1.0))))


def check_extent(source: str, place_m: Array) -> None:
    """Raise `SYN-535` if frames lie beyond any map."""
    far_m = float(np.abs(place_m).max(initial=0.0))
    if not far_m < MAP_M:
        raise Refused(
            "SYN-535",
            f"{source}: its positions reach {far_m / 1000:,.0f} km from the first, but a map extends over "
            f"{MAP_M / 1000:.0f} km. "
            "If the source jumps between frames or writes zeros, choose another, or estimate the poses from the "
            "sweeps: --odometry kiss-icp",
        )


def refuse_degrees(topic: str, stamps_ns: Stamps, poses: SE3) -> None:
    """Raise `SYN-533` for positions in degrees: as metres the robot would creep smoothly by millionths."""
    positions = poses.translation_m[:, :2]
    usual = np.median(positions, axis=0)
    positions = positions[np.abs(positions - usual).max(axis=1) < MOST_SPAN_DEG]
    is_range = np.abs(usual).max() <= 180 and np.abs(usual).min() <= 90 and np.abs(usual).max() >= 0.5
    if not is_range or len(positions) < 2 * len(poses) // 3:
        return
    gap_ns = max(1, int(np.median(np.diff(stamps_ns)))) if len(stamps_ns) > 1 else 1
    stride = max(1, STEP_NS // gap_ns)
    steps_m = np.diff(positions[::stride], axis=0) * DEGREE_M
    lengths_m = np.hypot(*steps_m.T)
    elapsed_s = gap_ns * 1e-9 * len(poses)  # a clock that is set meanwhile does not lengthen the drive
    if len(steps_m) < 3 or not LEAST_WAY_M <= lengths_m.sum() <= FASTEST_M_S * elapsed_s:
        return
    way = np.arctan2(steps_m[:, 1], steps_m[:, 0])[lengths_m > 0.1 * np.median(lengths_m)]
    bends = np.abs(np.angle(np.exp(1j * np.diff(way))))
    if not len(bends) or np.median(bends) > MOST_BEND_RAD:
        return
    raise Refused(
        "SYN-533",
        f"{topic}: its positions are degrees, not metres: they stay within {np.ptp(positions, axis=0).max():.2g} "
        f"around ({usual[0]:.5f}, {usual[1]:.5f}), as latitude and longitude of a drive of {lengths_m.sum():.0f} m "
        "would. "
        "Record them in metres (UTM or a local frame), publish a sensor_msgs/msg/NavSatFix, or estimate the poses from "
        "the sweeps: --odometry kiss-icp",
    )
