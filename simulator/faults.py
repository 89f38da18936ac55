"""Simulated sensor faults, each a small change of the recording.

**Conventions.** A fault changes one part and leaves the others unchanged, so several compose in the given order. Record
times stay those of the recorder's clock: a fault of a sensor's clock moves header stamps only, a fault of its trigger
moves the exposure itself. The ground truth does not change.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simulator.options import BESTPOS_TOPIC, INSPVAX_TOPIC, LIDAR_TOPIC, FaultName
from simulator.scenery.world import START_NS, generator
from simulator.sensors import rig
from simulator.sensors.cameras import SimulatedPicture
from simulator.sensors.navigation import FIX_NS, Fixes, Inertia
from simulator.sensors.rig import CameraSpec
from stone.sensors.calibration import Calibration

Stamps = NDArray[np.int64]
HOST_DELAY_NS = 45_000_000  # less than the 50 ms between two fixes, so that they keep their order
GPS_AHEAD_OF_UTC_NS, TAI_AHEAD_OF_UTC_NS = 18_000_000_000, 37_000_000_000
LATE_CHANNEL, LATE_NS = "CAM_FRONT_LEFT", 5_000_000
DROPPING_CHANNEL, DROPS_EVERY = "CAM_FRONT_RIGHT", 4
SWAPPED_CHANNELS = ("CAM_FRONT_LEFT", "CAM_FRONT_RIGHT")
INVERTED_CHANNEL = "CAM_FRONT"
DRIFTING_TOPIC, DRIFT_RATIO = rig.radar_topic("RADAR_LEFT"), 50e-6
STEPPING_TOPIC, STEPS_EVERY, STEP_BACK_NS = rig.radar_topic("RADAR_RIGHT"), 10, 80_000_000
IMU_LAG_NS = 12_000_000
FIX_GAP_NS = 400_000_000
JUMP_NORTH_M, JUMP_EAST_M, FLOAT_STDEV_M = 1.5, 2.0, 0.45
METRES_PER_DEGREE = 111_195.0


@dataclass(frozen=True)
class Fault:
    """One fault; parts that it does not set stay unchanged."""

    fixes: Callable[[Fixes], Fixes] = lambda fixes: fixes
    inertia: Callable[[Inertia], Inertia] = lambda inertia: inertia
    triggers: Callable[[CameraSpec], CameraSpec] = lambda camera: camera
    pictures: Callable[[list[SimulatedPicture], int], list[SimulatedPicture]] = lambda pictures, sweep: pictures
    clock: Callable[[str, Stamps], Stamps] = lambda topic, stamps_ns: stamps_ns
    calibration: Callable[[Calibration], Calibration] = lambda calibration: calibration


def after(first: Fault, second: Fault) -> Fault:
    """Return the fault that applies `first`, then `second`."""
    return Fault(
        lambda fixes: second.fixes(first.fixes(fixes)),
        lambda inertia: second.inertia(first.inertia(inertia)),
        lambda camera: second.triggers(first.triggers(camera)),
        lambda pictures, sweep: second.pictures(first.pictures(pictures, sweep), sweep),
        lambda topic, stamps_ns: second.clock(topic, first.clock(topic, stamps_ns)),
        lambda calibration: second.calibration(first.calibration(calibration)),
    )


def all_of(names: tuple[FaultName, ...]) -> Fault:
    """Return these faults combined in this order; the identity for no names."""
    fault = Fault()
    for name in names:
        fault = after(fault, FAULTS[name])
    return fault


def _jittered_on_the_host(fixes: Fixes) -> Fixes:
    """Delay publishing and stamps by up to 45 ms, as on a busy host."""
    late = generator(0, "gnss_jitter").integers(0, HOST_DELAY_NS, len(fixes.stamps_ns))
    return replace(fixes, host_stamps_ns=fixes.stamps_ns + late)


def _with_a_gap(fixes: Fixes) -> Fixes:
    """Drop all fixes for 0.4 s in the middle of the run."""
    lost_ns = fixes.stamps_ns[len(fixes.stamps_ns) // 2]
    return fixes.where((fixes.stamps_ns <= lost_ns) | (fixes.stamps_ns >= lost_ns + FIX_GAP_NS))


def _jumping(fixes: Fixes) -> Fixes:
    """From the middle of the run RTK only floats, 2.5 m away."""
    is_off = fixes.stamps_ns >= fixes.stamps_ns[len(fixes.stamps_ns) // 2]
    north_deg = JUMP_NORTH_M / METRES_PER_DEGREE
    east_deg = JUMP_EAST_M / (METRES_PER_DEGREE * np.cos(np.deg2rad(fixes.geodetic_deg_m[0, 0])))
    return replace(
        fixes,
        geodetic_deg_m=fixes.geodetic_deg_m + is_off[:, None] * np.array([north_deg, east_deg, 0.0]),
        is_rtk_fixed=fixes.is_rtk_fixed & ~is_off,
        position_stdev_m=np.where(is_off, FLOAT_STDEV_M, fixes.position_stdev_m),
    )


def _ahead(topics: tuple[str, ...], ahead_ns: int) -> Fault:
    return Fault(clock=lambda topic, stamps_ns: stamps_ns + ahead_ns if topic in topics else stamps_ns)


def _drifting(topic: str, stamps_ns: Stamps) -> Stamps:
    """Let the oscillator of one radar run fast."""
    if topic != DRIFTING_TOPIC:
        return stamps_ns
    ahead_ns: Stamps = np.rint((stamps_ns - START_NS) * DRIFT_RATIO).astype(np.int64)
    return stamps_ns + ahead_ns


def _stepping_back(topic: str, stamps_ns: Stamps) -> Stamps:
    """Give every tenth list of one radar a stamp older than the list before it."""
    if topic != STEPPING_TOPIC:
        return stamps_ns
    turn = (stamps_ns - START_NS) // FIX_NS % STEPS_EVERY
    return np.where(turn == STEPS_EVERY - 1, stamps_ns - STEP_BACK_NS, stamps_ns)


def _late(camera: CameraSpec) -> CameraSpec:
    return replace(camera, phase_ns=camera.phase_ns + LATE_NS) if camera.channel == LATE_CHANNEL else camera


def _dropping(pictures: list[SimulatedPicture], sweep: int) -> list[SimulatedPicture]:
    if sweep % DROPS_EVERY != DROPS_EVERY - 1:
        return pictures
    return [picture for picture in pictures if picture.camera.channel != DROPPING_CHANNEL]


def _swapped(pictures: list[SimulatedPicture], sweep: int) -> list[SimulatedPicture]:
    """Swap two cables: each image is published on the other camera's topic."""
    cameras = {camera.channel: camera for camera in rig.cameras()}
    left, right = SWAPPED_CHANNELS
    published = {left: cameras[right], right: cameras[left]}
    return [replace(picture, camera=published.get(picture.camera.channel, picture.camera)) for picture in pictures]


def _inverted(calibration: Calibration) -> Calibration:
    """Invert the mount of one camera in the calibration; the robot's /tf_static stays right."""
    mounts = tuple(
        replace(mount, lidar_from_sensor=mount.lidar_from_sensor.inverse()) if mount.name == INVERTED_CHANNEL else mount
        for mount in calibration.mounts
    )
    return replace(calibration, mounts=mounts)


FAULTS: Mapping[FaultName, Fault] = {
    "gnss_jitter": Fault(fixes=_jittered_on_the_host),
    "clock_18s": _ahead((INSPVAX_TOPIC, BESTPOS_TOPIC), GPS_AHEAD_OF_UTC_NS),
    "clock_37s": _ahead((LIDAR_TOPIC,), TAI_AHEAD_OF_UTC_NS),
    "camera_late_5ms": Fault(triggers=_late),
    "camera_dropped": Fault(pictures=_dropping),
    "radar_drift_50ppm": Fault(clock=_drifting),
    "imu_lag_12ms": Fault(inertia=lambda inertia: replace(inertia, stamps_ns=inertia.stamps_ns + IMU_LAG_NS)),
    "rtk_gap": Fault(fixes=_with_a_gap),
    "position_jump": Fault(fixes=_jumping),
    "stamps_back": Fault(clock=_stepping_back),
    "cameras_swapped": Fault(pictures=_swapped),
    "extrinsic_inverted": Fault(calibration=_inverted),
}
