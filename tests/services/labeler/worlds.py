"""Small worlds whose sweeps are ray-cast in closed form: a plane z = a·x + b·y, and boxes that stand on it.

Here and not in a test, because the labeler's worker processes import the sweep source by its name.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone.sensors.calibration import Box, Calibration, CameraIntrinsics, Mount
from stone.sensors.sequence import Frames, Sequence, Sweep, frame_token

PERIOD_NS = 100_000_000
EGO_FROM_LIDAR = SE3(np.array([1.0, 0, 0, 0, 0.2, 0.0, 1.2]))
# z forward is x, x right is −y, y down is −z
CAMERA = Mount(
    "CAM_FRONT",
    "camera",
    SE3.from_parts(np.array([0.5, -0.5, 0.5, -0.5]), np.zeros(3)),
    intrinsics=CameraIntrinsics("pinhole", 640, 480, 400.0, 400.0, 320.0, 240.0),
)
CALIBRATION = Calibration("small", EGO_FROM_LIDAR, (CAMERA,))


@dataclass(frozen=True)
class World:
    """`grade` (a, b) of the plane; boxes in the world frame; `map_from_world` puts it all elsewhere in the map."""

    grade: tuple[float, float] = (0.0, 0.0)
    boxes: tuple[Box, ...] = ()
    map_from_world: tuple[float, ...] = (1.0, 0, 0, 0, 24.0, 24.0, 0)
    frames: int = 12
    step_m: float = 0.4
    reach_m: float = 7.0
    spacing_m: float = 0.14
    breaks_at: int = -1

    def placed(self) -> SE3:
        return SE3(np.array(self.map_from_world))

    def world_from_ego(self, index: int) -> SE3:
        """The robot drives along x, its origin on the plane and its axes tilted with it."""
        a, b = self.grade
        up = np.array([-a, -b, 1.0]) / np.linalg.norm([a, b, 1.0])
        forward = np.array([1.0, 0.0, a]) / np.hypot(1.0, a)
        matrix = np.eye(4)
        matrix[:3, :3] = np.stack([forward, np.cross(up, forward), up], axis=1)
        x = (index - (self.frames - 1) / 2) * self.step_m
        matrix[:3, 3] = [x, 0.0, a * x]
        return SE3.from_matrix(matrix)


def ranges(origin: NDArray[np.float64], rays: NDArray[np.float64], world: World) -> NDArray[np.float64]:
    """Distance along each ray (R, 3), in its own lengths, to the plane or the nearest box; infinite where none."""
    a, b = world.grade
    normal = np.array([-a, -b, 1.0])
    with np.errstate(divide="ignore", invalid="ignore"):
        nearest = -(origin @ normal) / (rays @ normal)
        nearest[~(nearest > 0)] = np.inf
        for box in world.boxes:
            near, far = (np.array(box.min_m) - origin) / rays, (np.array(box.max_m) - origin) / rays
            enter, leave = np.minimum(near, far).max(axis=1), np.maximum(near, far).min(axis=1)
            hit = (enter <= leave) & (enter > 0)
            nearest[hit] = np.minimum(nearest[hit], enter[hit])
    return nearest


@dataclass(frozen=True)
class RayCast:
    """Rays aimed at a jittered lattice on the ground and at random places within each box."""

    world: World

    def sweep(self, index: int) -> Sweep:
        if index == self.world.breaks_at:
            raise RuntimeError("this sweep cannot be read")
        rng = np.random.default_rng(index)
        world_from_lidar = self.world.world_from_ego(index) @ EGO_FROM_LIDAR
        rays = self._targets(world_from_lidar.translation_m, rng) - world_from_lidar.translation_m
        distance = ranges(world_from_lidar.translation_m, rays, self.world)
        met = np.isfinite(distance)
        points = world_from_lidar.translation_m + rays[met] * distance[met, None]
        return Sweep(stamp_of(index), (world_from_lidar.inverse() @ points).astype(np.float32))

    def _targets(self, around: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
        line = np.arange(-self.world.reach_m, self.world.reach_m, self.world.spacing_m)
        plan = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2) + rng.uniform(0, self.world.spacing_m, 2)
        plan = plan[np.hypot(*plan.T) < self.world.reach_m] + around[:2]
        ground = np.column_stack([plan, plan @ np.array(self.world.grade)])
        return np.concatenate([ground, *(rng.uniform(box.min_m, box.max_m, (1500, 3)) for box in self.world.boxes)])


def stamp_of(index: int) -> int:
    return 1_760_000_000_000_000_000 + index * PERIOD_NS


def sequence_of(world: World, name: str = "small") -> Sequence:
    poses = [world.placed() @ world.world_from_ego(index) for index in range(world.frames)]
    stamps_ns = np.array([stamp_of(index) for index in range(world.frames)], np.int64)
    tokens = tuple(frame_token(name, int(stamp)) for stamp in stamps_ns)
    frames = Frames(stamps_ns, tokens, SE3(np.stack([pose.wxyz_xyz for pose in poses])))
    return Sequence(name, frames, (), CALIBRATION, "odometry /odom", inputs={"small.mcap": "ab" * 32})


def elsewhere(world: World, map_from_world: tuple[float, ...]) -> World:
    return replace(world, map_from_world=map_from_world)
