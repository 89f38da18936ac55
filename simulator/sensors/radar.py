"""Three ARS 548: sparse detections with range rate, at 20 Hz.

**Conventions.** Azimuth is positive to the left, elevation up, in the radar's frame (x forward, y left, z up); range
rate is positive when the target recedes. Only the first `count` slots of a list are valid: the rest contain stale
detections, like the sensor's own lists.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.cdr_writer import tiled
from simulator.ros_messages import DETECTION, MAX_DETECTIONS
from simulator.scenery.objects import Surface
from simulator.scenery.path import POSE_NS
from simulator.scenery.scene import RayScene
from simulator.sensors import rig
from simulator.sensors.navigation import FIX_NS
from stone.geometry.se3 import SE3, Array

RAYS = 400
PHASE_NS = 7_000_000
VIEW_AZIMUTH_RAD = np.deg2rad(60.0)
VIEW_ELEVATION_RAD = np.deg2rad(14.0)
CHANCE = {
    Surface.SKY: 0.0, Surface.GROUND: 0.12, Surface.ROCK: 0.7, Surface.BUSH: 0.4, Surface.TRUNK: 0.8,
    Surface.CROWN: 0.3, Surface.WALL: 0.9, Surface.GRASS: 0.1, Surface.WALKER: 0.9, Surface.ROBOT: 0.0,
    Surface.VEHICLE: 0.9,
}  # fmt: skip
RCS_DBSM = {
    Surface.SKY: 0, Surface.GROUND: -18, Surface.ROCK: -4, Surface.BUSH: -10, Surface.TRUNK: 0,
    Surface.CROWN: -8, Surface.WALL: 10, Surface.GRASS: -20, Surface.WALKER: -3, Surface.ROBOT: 0,
    Surface.VEHICLE: 10,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class RadarLists:
    """The lists of one instant, one row per radar: valid `counts` and all 800 slots (radars, 800)."""

    stamp_ns: int
    counts: NDArray[np.int64]
    detections: NDArray[np.void]


@dataclass(frozen=True, eq=False)
class Radars:
    """The parts that are the same for every list: the unused slots (800,) and the noise of the used ones."""

    stale: NDArray[np.void]
    noise_ratio: float


def stale_detections(rng: np.random.Generator) -> NDArray[np.void]:
    """Return the content of the unused slots (800,): plausible numbers that must not be read."""
    stale = np.zeros(MAX_DETECTIONS, DETECTION)
    stale["range"] = rng.uniform(1, 300, MAX_DETECTIONS)
    stale["azimuth"] = rng.uniform(-1, 1, MAX_DETECTIONS)
    stale["range_rate"] = rng.uniform(-60, 30, MAX_DETECTIONS)
    stale["rcs"] = rng.integers(-40, 40, MAX_DETECTIONS)
    stale["measurement_id"] = rng.integers(0, 65536, MAX_DETECTIONS)
    return stale


def scan(scene: RayScene, stamps_ns: list[int], radars: Radars, rng: np.random.Generator) -> list[RadarLists]:
    """Return the lists of all radars at these stamps, from one cast."""
    mounts = [rig.ego_from_radar(channel) for channel in rig.RADARS]
    stamps = np.repeat(np.array(stamps_ns, np.int64), len(mounts))
    ego_from_radar = SE3(np.tile(np.array([mount.wxyz_xyz for mount in mounts]), (len(stamps_ns), 1)))
    pose = scene.world.trajectory.at(stamps) @ ego_from_radar
    before, after = (scene.world.trajectory.at(stamps + at_ns) @ ego_from_radar for at_ns in (-POSE_NS, POSE_NS))
    velocity = (after.translation_m - before.translation_m) / (2 * POSE_NS * 1e-9)
    azimuth = rng.uniform(-VIEW_AZIMUTH_RAD, VIEW_AZIMUTH_RAD, (len(stamps), RAYS))
    elevation = rng.uniform(-VIEW_ELEVATION_RAD, VIEW_ELEVATION_RAD, (len(stamps), RAYS))
    flat = np.cos(elevation)
    local = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)
    directions = local @ np.swapaxes(pose.rotation(), -1, -2)
    origins = np.broadcast_to(pose.translation_m[:, None], directions.shape)
    hits = scene.cast(origins.reshape(-1, 3).astype(np.float32), directions.reshape(-1, 3).astype(np.float32))
    range_m = hits.range_m.reshape(len(stamps), RAYS)
    surface = hits.surface.reshape(len(stamps), RAYS)
    chance = np.array([CHANCE[kind] for kind in Surface])[surface]
    is_seen = (rng.random(chance.shape) < chance) & np.isfinite(range_m)
    approach = np.einsum("sri,si->sr", directions, velocity)
    slots = tiled(radars.stale.tobytes(), len(stamps), DETECTION).reshape(len(stamps), MAX_DETECTIONS)
    for row in range(len(stamps)):
        seen = is_seen[row]
        measured = (azimuth[row, seen], elevation[row, seen], range_m[row, seen], -approach[row, seen])
        noise = radars.noise_ratio * rng.standard_normal((4, len(measured[0])))
        _fill(slots[row], measured, surface[row, seen], noise)
    counts = is_seen.sum(axis=1).reshape(len(stamps_ns), -1)
    lists = slots.reshape(len(stamps_ns), -1, MAX_DETECTIONS)
    return [RadarLists(stamp, counts[index], lists[index]) for index, stamp in enumerate(stamps_ns)]


def _fill(
    slots: NDArray[np.void],
    measured: tuple[Array, Array, NDArray[np.float32], Array],
    surface: NDArray[np.uint8],
    noise: Array,
) -> None:
    """Write the visible rays into the first slots of one list, with the sensor's noise and its own deviations."""
    azimuth, elevation, range_m, range_rate = measured
    count = len(azimuth)
    valid = slots[:count]
    for name, value, deviation, row in (
        ("azimuth", azimuth, 0.004, 0),
        ("elevation", elevation, 0.008, 1),
        ("range", range_m, 0.10, 2),
        ("range_rate", range_rate, 0.05, 3),
    ):
        valid[name] = value + deviation * noise[row]
        valid[f"{name}_std"] = deviation
    valid["rcs"] = np.array([RCS_DBSM[kind] for kind in Surface], np.int8)[surface]
    valid["measurement_id"] = np.arange(count)
    valid["positive_predictive_value"] = 95
    valid["sort_index"] = np.arange(count)


def scan_stamps_ns(sweep_stamp_ns: int) -> list[int]:
    """Return the radar instants within one sweep: 20 Hz, on the radar's own clock phase."""
    first = sweep_stamp_ns + PHASE_NS
    return list(range(first, first + rig.SWEEP_NS, FIX_NS))
