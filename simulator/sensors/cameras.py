"""Six JPEG images per sweep, each taken when the LiDAR points in the camera's direction.

**Conventions.** A coarse image is cast at `COARSE_RAYS` and enlarged: edges, colours and times agree with the LiDAR,
but it lacks detail. A full image has a ray through the centre of each pixel, a half image a ray for every 2 × 2 pixels;
both have a sensor's noise. Optical frames: z forward, x right, y down.
"""

from dataclasses import dataclass
from io import BytesIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from simulator.appearance.lights import LIGHTS, Light
from simulator.appearance.renderer import Renderer, View
from simulator.options import SimulateOptions
from simulator.scenery.path import DriveTrajectory
from simulator.scenery.world import generator
from simulator.sensors import rig
from stone.geometry.se3 import SE3, Array
from stone.sensors.calibration import CameraIntrinsics

COARSE_RAYS = (80, 50)
JPEG_QUALITY = 80
TRIGGER_JITTER_NS = 50_000
LAMP_ABOVE_M = 0.25  # above its camera
FRONT_LAMP = 3.0  # relative to the other lamps


@dataclass(frozen=True, eq=False)
class CameraRing:
    """The mount of each camera, the rays of one in its optical frame (rows, columns, 3), and the image options."""

    cameras: tuple[rig.CameraSpec, ...]
    directions: NDArray[np.float32]
    pixel_rad: float
    size_px: tuple[int, int]
    light: Light
    options: SimulateOptions


@dataclass(frozen=True)
class SimulatedPicture:
    """One exposure."""

    camera: rig.CameraSpec
    stamp_ns: int
    jpeg: bytes


def build_ring(options: SimulateOptions) -> CameraRing:
    """Return the pinhole cameras of these options, with rays through equal parts of the image."""
    lens = rig.intrinsics(options.camera_width_px)
    parts = {"full": 1, "half": 2}.get(options.camera_detail)
    columns, rows = COARSE_RAYS if parts is None else (lens.width_px // parts, lens.height_px // parts)
    pixel_rad = lens.width_px / columns / lens.fx_px
    size_px = (lens.width_px, lens.height_px)
    return CameraRing(
        rig.cameras(), _rays(lens, columns, rows), pixel_rad, size_px, LIGHTS[options.illumination], options
    )


def _rays(lens: CameraIntrinsics, columns: int, rows: int) -> NDArray[np.float32]:
    """Return unit rays through the centres of `columns` × `rows` equal parts of the image (rows, columns, 3)."""
    u = (np.arange(columns) + 0.5) * lens.width_px / columns - 0.5
    v = (np.arange(rows) + 0.5) * lens.height_px / rows - 0.5
    x, y = np.meshgrid((u - lens.cx_px) / lens.fx_px, (v - lens.cy_px) / lens.fy_px)
    rays: Array = np.stack([x, y, np.ones_like(x)], axis=-1)
    return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True), np.float32)


def take_pictures(
    renderer: Renderer, ring: CameraRing, stamp_ns: int, rng: np.random.Generator
) -> list[SimulatedPicture]:
    """Return the six exposures of the sweep at `stamp_ns`, in the order of `ring.cameras`."""
    jitter = rng.integers(-TRIGGER_JITTER_NS, TRIGGER_JITTER_NS, len(ring.cameras))
    jitter = np.rint(jitter * ring.options.noise_ratio).astype(np.int64)
    stamps = stamp_ns + np.array([camera.phase_ns for camera in ring.cameras]) + jitter
    view = _view(renderer.world.trajectory, ring, stamps, stamp_ns + rig.SWEEP_NS // 2)
    seen = renderer.pixels(view).reshape(len(ring.cameras), *ring.directions.shape)
    pictures = []
    for camera, exposed_ns, rays in zip(ring.cameras, stamps.tolist(), seen, strict=True):
        pixels = _enlarged(rays, ring.size_px)
        if ring.options.camera_detail != "coarse":
            pixels = _with_noise(pixels, ring, generator(ring.options.seed, f"{camera.channel} {stamp_ns}"))
        pictures.append(SimulatedPicture(camera, exposed_ns, _jpeg(pixels)))
    return pictures


def _view(trajectory: DriveTrajectory, ring: CameraRing, stamps_ns: NDArray[np.int64], middle_ns: int) -> View:
    """Return the rays of all cameras, each from its pose at its own stamp; movers and lamps are taken in the middle of
    the sweep.
    """
    poses = trajectory.at(stamps_ns)
    mounts = [poses[index] @ rig.ego_from_camera(camera) for index, camera in enumerate(ring.cameras)]
    turns = np.array([mount.rotation() for mount in mounts], np.float32)
    places = np.array([mount.translation_m for mount in mounts], np.float32)
    rays = ring.directions.reshape(-1, 3)
    directions = (rays @ np.swapaxes(turns, -1, -2)).reshape(-1, 3)
    origins = np.repeat(places, len(rays), axis=0)
    lamps = _lamps(trajectory.at(np.array([middle_ns], np.int64))[0], ring.light.lamp)
    return View(origins, directions, ring.pixel_rad, middle_ns, lamps)


def _lamps(map_from_ego: SE3, strength: float) -> Array:
    """Return one lamp above each camera with the same direction (L, 7): position, axis, strength; none by day."""
    if strength == 0.0:
        return np.zeros((0, 7))
    mounts = [map_from_ego @ rig.ego_from_camera(camera) for camera in rig.cameras()]
    rotations = np.array([mount.rotation() for mount in mounts])
    places = np.array([mount.translation_m for mount in mounts]) - LAMP_ABOVE_M * rotations[:, :, 1]
    strengths = [strength * (FRONT_LAMP if camera.channel == "CAM_FRONT" else 1.0) for camera in rig.cameras()]
    return np.concatenate([places, rotations[:, :, 2], np.array(strengths)[:, None]], axis=1)


def _enlarged(pixels: NDArray[np.uint8], size_px: tuple[int, int]) -> NDArray[np.uint8]:
    if pixels.shape[1::-1] == size_px:
        return pixels
    return np.asarray(Image.fromarray(pixels).resize(size_px, Image.Resampling.BILINEAR))


def _with_noise(pixels: NDArray[np.uint8], ring: CameraRing, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Add grain of brightness and, half as much, of colour; less of both in bright areas."""
    deviation = ring.options.noise_ratio * ring.light.noise_8bit * np.linspace(1.0, 0.5, 256, dtype=np.float32)
    grain = 0.5 * rng.standard_normal(pixels.shape, np.float32)
    grain += rng.standard_normal((*pixels.shape[:2], 1), np.float32)
    grain *= deviation[pixels]
    grain += pixels
    return np.clip(np.rint(grain, out=grain), 0, 255, out=grain).astype(np.uint8)


def _jpeg(pixels: NDArray[np.uint8]) -> bytes:
    buffer = BytesIO()
    Image.fromarray(pixels).save(buffer, "JPEG", quality=JPEG_QUALITY)
    return buffer.getvalue()
