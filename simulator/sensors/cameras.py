"""Six JPEG pictures a sweep, each taken when the LiDAR looks the camera's way.

**Conventions.** Pictures are cast at `RAY_COLUMNS` × `RAY_ROWS` and enlarged: what matters is that edges, colours and
times agree with the LiDAR, not the detail. Optical frames: z forward, x right, y down.
"""

from dataclasses import dataclass
from io import BytesIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from simulator.options import SimulateOptions
from simulator.scenery.objects import Surface
from simulator.scenery.scene import Hits, RayScene, put_mover
from simulator.sensors import rig

RAY_COLUMNS, RAY_ROWS = 80, 50
JPEG_QUALITY = 80
TRIGGER_JITTER_NS = 50_000
SUN = np.array([0.35, -0.45, 0.82], np.float32)
HAZE_M = 90.0
SKY_LOW, SKY_HIGH = np.array([205, 215, 225], np.float32), np.array([110, 155, 215], np.float32)
COLOURS = {
    Surface.SKY: (0, 0, 0), Surface.GROUND: (136, 112, 78), Surface.ROCK: (128, 128, 124),
    Surface.BUSH: (62, 96, 44), Surface.TRUNK: (84, 62, 44), Surface.CROWN: (48, 88, 40),
    Surface.WALL: (172, 160, 146), Surface.GRASS: (128, 148, 66), Surface.WALKER: (210, 60, 40),
    Surface.VEHICLE: (52, 78, 140),
    Surface.ROBOT: (40, 40, 44),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class CameraRing:
    """The rays of one camera in its optical frame (rays, 3), and where each camera sits."""

    cameras: tuple[rig.CameraSpec, ...]
    directions: NDArray[np.float32]
    size_px: tuple[int, int]
    palette: NDArray[np.float32]
    noise_ratio: float


@dataclass(frozen=True)
class SimulatedPicture:
    """One exposure."""

    camera: rig.CameraSpec
    stamp_ns: int
    jpeg: bytes


def build_ring(options: SimulateOptions) -> CameraRing:
    """Rays through the centres of the low-resolution pixels of the full-size pinhole."""
    lens = rig.intrinsics(options.camera_width_px)
    u = (np.arange(RAY_COLUMNS) + 0.5) * lens.width_px / RAY_COLUMNS - 0.5
    v = (np.arange(RAY_ROWS) + 0.5) * lens.height_px / RAY_ROWS - 0.5
    x, y = np.meshgrid((u - lens.cx_px) / lens.fx_px, (v - lens.cy_px) / lens.fy_px)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    palette = np.array([COLOURS[surface] for surface in Surface], np.float32)
    size_px = (lens.width_px, lens.height_px)
    return CameraRing(rig.cameras(), rays.astype(np.float32), size_px, palette, options.noise_ratio)


def take_pictures(scene: RayScene, ring: CameraRing, stamp_ns: int, rng: np.random.Generator) -> list[SimulatedPicture]:
    """The six exposures of the sweep at `stamp_ns`, in the order of `ring.cameras`."""
    jitter = rng.integers(-TRIGGER_JITTER_NS, TRIGGER_JITTER_NS, len(ring.cameras))
    jitter = np.rint(jitter * ring.noise_ratio).astype(np.int64)
    stamps = stamp_ns + np.array([camera.phase_ns for camera in ring.cameras]) + jitter
    poses = scene.world.trajectory.at(stamps)
    turns, places = [], []
    for index, camera in enumerate(ring.cameras):
        map_from_camera = poses[index] @ rig.ego_from_camera(camera)
        turns.append(map_from_camera.rotation().astype(np.float32))
        places.append(map_from_camera.translation_m.astype(np.float32))
    directions = (ring.directions @ np.swapaxes(np.array(turns), -1, -2)).reshape(-1, 3)
    origins = np.repeat(np.array(places), len(ring.directions), axis=0)
    hits = scene.cast(origins, directions)
    for mover in scene.world.movers:
        put_mover(hits, mover, stamp_ns + rig.SWEEP_NS // 2, (origins, directions), slice(None))
    pixels = shade(hits, origins, directions, ring.palette).reshape(len(ring.cameras), RAY_ROWS, RAY_COLUMNS, 3)
    return [
        SimulatedPicture(camera, int(stamps[index]), _jpeg(pixels[index], ring.size_px))
        for index, camera in enumerate(ring.cameras)
    ]


def shade(
    hits: Hits, origins: NDArray[np.float32], directions: NDArray[np.float32], palette: NDArray[np.float32]
) -> NDArray[np.uint8]:
    """Colours (N, 3): the surface's, lit by a fixed sun, mottled by place, fading into haze."""
    is_hit = np.isfinite(hits.range_m)
    reach = np.where(is_hit, hits.range_m, np.float32(0))
    light = 0.45 + 0.55 * np.abs(hits.normal @ SUN)
    points = origins[:, :2] + reach[:, None] * directions[:, :2]
    mottle = 1 + 0.10 * np.sin(points[:, 0] * 5.1) * np.sin(points[:, 1] * 4.3 + points[:, 0])
    haze = (1 - np.exp(-reach / HAZE_M))[:, None]
    up = np.clip(directions[:, 2:3] * 2, 0, 1)
    colour = palette[hits.surface] * (light * mottle)[:, None] * (1 - haze) + SKY_LOW * haze
    sky = SKY_LOW * (1 - up) + SKY_HIGH * up
    return np.where(is_hit[:, None], np.clip(colour, 0, 255), sky).astype(np.uint8)


def _jpeg(pixels: NDArray[np.uint8], size_px: tuple[int, int]) -> bytes:
    buffer = BytesIO()
    Image.fromarray(pixels).resize(size_px, Image.Resampling.BILINEAR).save(buffer, "JPEG", quality=JPEG_QUALITY)
    return buffer.getvalue()
