"""Sweeps of the spinning LiDAR: every packet of columns is cast from the exact pose at its own time.

**Conventions.** Points are in the LiDAR frame *at their own time* (motion distortion is real). A packet's points
share one timestamp, as on the OT128; the header stamp is the first packet's. A ray without return is (0, 0, 0).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.options import SimulateOptions
from simulator.ros_messages import HESAI_POINT
from simulator.scenery.objects import Surface
from simulator.scenery.scene import Hits, Rays, RayScene, put_mover, rays_towards
from simulator.sensors import rig
from stone.geometry.se3 import Array
from stone.sensors.calibration import Box

# Disturbances of a real LiDAR's ranges: surfaces that return too little, beams on an edge, drops in the air. A sweep's
# rays are (columns · channels,) in firing order, a column after another; no return is inf. Inputs per ray: the range of
# the hit surface, the cosine of the incidence there, and the reflectivity in [0, 1]. Dropouts: the mean returned power
# is proportional to reflectivity · cos(incidence) / range² (Lambert); speckle makes it exponentially distributed around
# its mean (Goodman, Speckle Phenomena in Optics, ch. 2), so a share exp(−threshold / mean) of the pulses is detected.
# Mixed pixels: a beam as wide as `beam_rad` lies across the edge between its own surface and the next column's. Its
# probability is the beam's share of the angle between them. Echoes closer than a pulse's length merge into one between
# the two surfaces. Rain: drops, insects and dust stop a ray at a constant rate along it, as far as they return enough.


Ranges = NDArray[np.float32]
DARKEST = 1e-9


@dataclass(frozen=True)
class RangeNoise:
    """The strength of the disturbances: from a surface of `half_reflectivity`, hit head-on at `half_range_m`, half the
    pulses return.

    The defaults are those of small LiDARs of 16 to 64 channels: 45 m on 10 %, 3 mrad, a pulse of 10 ns. The default
    rain is moderate, 2 of 1,000 rays.
    """

    half_range_m: float = 45.0
    half_reflectivity: float = 0.1
    beam_rad: float = 0.003
    least_gap_m: float = 0.1
    pulse_m: float = 1.5
    drops_per_m: float = 1e-4
    drops_reach_m: float = 20.0


@dataclass(frozen=True, eq=False)
class Returns:
    """The surfaces hit by the rays of one sweep: range (N,), cosine of incidence (N,), reflectivity (N,)."""

    range_m: Ranges
    cosine: Ranges
    reflectivity: Ranges


def disturbed(returns: Returns, channels: int, noise: RangeNoise, rng: np.random.Generator) -> Ranges:
    """Return the ranges (N,) with mixed pixels, dropouts and rain, in this order."""
    range_m = mixed(returns.range_m, channels, noise, rng)
    range_m = np.where(rng.random(len(range_m)) < detected_share(returns, noise), range_m, np.float32(np.inf))
    return rained(range_m, noise, rng)


def detected_share(returns: Returns, noise: RangeNoise) -> Ranges:
    """Return the share of pulses that return from each surface (N,)."""
    lit = np.maximum(returns.reflectivity * returns.cosine, DARKEST) / noise.half_reflectivity
    return np.asarray(np.exp2(-((returns.range_m / noise.half_range_m) ** 2) / lit), np.float32)


def mixed(range_m: Ranges, channels: int, noise: RangeNoise, rng: np.random.Generator) -> Ranges:
    """Return the ranges with those of beams on an edge drawn between its two surfaces."""
    following = np.roll(range_m, -channels)
    is_wide = rng.random(len(range_m)) < noise.beam_rad * (len(range_m) // channels) / (2 * np.pi)
    part = rng.random(len(range_m), np.float32)
    with np.errstate(invalid="ignore"):  # inf − inf: both rays miss
        gap_m = following - range_m
        is_edge = (np.abs(gap_m) > noise.least_gap_m) & (np.abs(gap_m) < noise.pulse_m)
        return np.where(is_edge & is_wide, range_m + part * gap_m, range_m)


def rained(range_m: Ranges, noise: RangeNoise, rng: np.random.Generator) -> Ranges:
    """Return the ranges with those of rays that end at a drop before any surface."""
    drop_m = rng.standard_exponential(len(range_m), np.float32) / np.float32(noise.drops_per_m)
    return np.where(drop_m < np.minimum(range_m, noise.drops_reach_m), drop_m, range_m).astype(np.float32)


REFLECTIVITY = {
    Surface.SKY: 0.0, Surface.GROUND: 30.0, Surface.ROCK: 45.0, Surface.BUSH: 60.0, Surface.TRUNK: 40.0,
    Surface.CROWN: 65.0, Surface.WALL: 90.0, Surface.GRASS: 70.0, Surface.WALKER: 80.0, Surface.ROBOT: 20.0,
    Surface.VEHICLE: 70.0,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Lidar:
    """The parts that are the same for every sweep."""

    directions: NDArray[np.float32]  # (steps, rays of a step, 3), LiDAR frame
    self_range_m: NDArray[np.float32]  # (rays,), inf where the ray clears the robot
    ring: NDArray[np.uint16]
    intensity: NDArray[np.float32]  # by Surface
    noise_m: float
    channels: int
    range_noise: RangeNoise | None
    sweep_ns: int

    @property
    def steps(self) -> int:
        return int(self.directions.shape[0])

    def packet_stamps_ns(self, stamp_ns: int) -> NDArray[np.int64]:
        """Return the firing time of each step of the sweep at `stamp_ns` (steps,)."""
        return stamp_ns + np.arange(self.steps, dtype=np.int64) * self.sweep_ns // self.steps


def build_lidar(options: SimulateOptions) -> Lidar:
    """Return the ray fan of these options, with the robot's own body in front of it."""
    fan = rig.lidar_directions(options.channels, options.columns)
    ring = np.tile(np.arange(options.channels, dtype=np.uint16), options.columns)
    directions = fan.reshape(rig.sweep_steps(options.columns), -1, 3)
    intensity = np.array([REFLECTIVITY[surface] for surface in Surface], np.float32)
    return Lidar(
        directions.astype(np.float32),
        robot_range(fan.reshape(-1, 3)),
        ring,
        intensity,
        options.noise_ratio * rig.LIDAR_NOISE_M,
        options.channels,
        RangeNoise() if options.range_noise else None,
        options.sweep_ns,
    )


def sweep_points(scene: RayScene, lidar: Lidar, stamp_ns: int, rng: np.random.Generator) -> NDArray[np.void]:
    """Return one sweep as `HESAI_POINT` records (rays,), in firing order."""
    world, packets_ns = scene.world, lidar.packet_stamps_ns(stamp_ns)
    map_from_lidar = world.trajectory.at(packets_ns) @ rig.EGO_FROM_LIDAR
    turn = map_from_lidar.rotation().astype(np.float32)
    directions = np.matmul(lidar.directions, np.swapaxes(turn, -1, -2)).reshape(-1, 3)
    origins = np.repeat(map_from_lidar.translation_m.astype(np.float32), lidar.directions.shape[1], axis=0)
    hits = scene.cast(origins, directions)
    middle_ns = stamp_ns + lidar.sweep_ns // 2
    for mover in world.movers:
        position = mover.route.at(middle_ns)[0]
        put_mover(
            hits, mover, middle_ns, (origins, directions), rays_towards(position, mover.reach_m, origins, directions)
        )
    surface = np.where(lidar.self_range_m < hits.range_m, np.uint8(Surface.ROBOT), hits.surface)
    range_m = np.minimum(lidar.self_range_m, hits.range_m)
    if lidar.range_noise is not None:
        returns = _returns(lidar, hits, directions, surface)
        range_m = disturbed(returns, lidar.channels, lidar.range_noise, rng)
    range_m += lidar.noise_m * rng.standard_normal(len(range_m), np.float32)
    return _records(lidar, range_m, surface, packets_ns)


def _returns(lidar: Lidar, hits: Hits, directions: Rays, surface: NDArray[np.uint8]) -> Returns:
    """Return the surfaces hit by the rays; the robot's own body is hit head-on."""
    range_m = np.minimum(lidar.self_range_m, hits.range_m)
    cosine = np.abs(np.einsum("ni,ni->n", directions, hits.normal))
    cosine[surface == Surface.ROBOT] = 1.0
    return Returns(range_m, cosine, lidar.intensity[surface] / np.float32(100))


def _records(
    lidar: Lidar, range_m: NDArray[np.float32], surface: NDArray[np.uint8], packets_ns: NDArray[np.int64]
) -> NDArray[np.void]:
    is_return = (range_m > rig.LIDAR_NEAR_M) & (range_m < rig.LIDAR_FAR_M)
    reach = np.where(is_return, range_m, np.float32(0))
    xyz = lidar.directions.reshape(-1, 3) * reach[:, None]
    records = np.empty(len(reach), HESAI_POINT)
    for axis, name in enumerate("xyz"):
        records[name] = xyz[:, axis]
    records["intensity"] = np.where(is_return, lidar.intensity[surface] / (1 + reach / 60), 0)
    records["ring"] = lidar.ring
    records["timestamp"] = np.repeat(packets_ns / 1e9, lidar.directions.shape[1])
    return records


def robot_range(directions: Array) -> NDArray[np.float32]:
    """Return the distance along LiDAR rays (N, 3) to the robot's own boxes and pole, inf for misses."""
    ego_directions = directions @ rig.EGO_FROM_LIDAR.rotation().T
    origin = rig.EGO_FROM_LIDAR.translation_m
    reach = _pole_range(ego_directions, origin)
    for box in rig.BODY_BOXES_EGO:
        reach = np.minimum(reach, _box_range(ego_directions, origin, box))
    return reach.astype(np.float32)


def _box_range(directions: Array, origin: Array, box: Box) -> Array:
    inverse = 1 / np.where(directions == 0, 1e-12, directions)
    low, high = (np.asarray(corner) - origin for corner in (box.min_m, box.max_m))
    near = np.minimum(low * inverse, high * inverse).max(axis=1)
    far = np.maximum(low * inverse, high * inverse).min(axis=1)
    return np.where((near < far) & (near > 0), near, np.inf)


def _pole_range(directions: Array, origin: Array) -> Array:
    offset = np.asarray(rig.POLE_EGO_XY_M) - origin[:2]
    plan = directions[:, :2]
    a, b = (plan**2).sum(axis=1), plan @ offset
    disc = b * b - a * (offset @ offset - rig.POLE_RADIUS_M**2)
    reach = (b - np.sqrt(np.maximum(disc, 0))) / np.maximum(a, 1e-12)
    z = origin[2] + reach * directions[:, 2]
    return np.where((disc > 0) & (reach > 0) & (z < rig.POLE_TOP_M) & (z > 0.5), reach, np.inf)
