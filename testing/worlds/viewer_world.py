"""A labelled run for the viewer: rolling ground by formula, a robot that drives over it, and all derived files.

**Conventions.** The ground is z = `height_m(x, y)`, and a map voxel exists if the ground passes through it. Its
features are those of the formula at its centre; its class follows from D² and the track, as in the labeler. Frames are
cut from the map as ego grids. `reach_m` limits the distance of voxels from each pose, and so their number.
"""

import json
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import select

from services.domain.viewer.formats import TileMesh, TileVoxels, cloud_bytes, detections_bytes, mesh_bytes, tile_bytes
from services.domain.viewer.playback import INDEX, PlacedSensor, PlaybackChannels, cloud_file, index_record, radar_file
from services.runtime.orm import Artefact, LabelSet, SequenceRow
from services.runtime.platform import Platform
from stone.labels.traversability import Reference, distance_squared, threshold
from stone_base.label_grid import MAP_VOXEL_M, PAPER, LabelGrid
from stone_files.npz import npz_bytes
from testing.api.serving import Person
from testing.worlds import made
from testing.worlds.viewer_cameras import CHANNELS, camera_files, played

Grid = NDArray[np.uint8]
Floats = NDArray[Any]
FRAME_NS = 100_000_000
REFERENCE = Reference(np.array([0.1, 0.09, -9.6]), np.diag([0.16, 0.003, 0.4]), 900, False)
LIMIT = threshold(0.05)
BLOCK_M = (6.0, -3.4, 7.0, -2.2, 1.4)
"""A box on the ground, N all over: x from and to, y from and to, height."""

SENSORS = (
    PlacedSensor("LIDAR_TOP", "lidar", (0.1, 0.0, 1.1, 1.0, 0.0, 0.0, 0.0)),
    PlacedSensor("RADAR_LEFT", "radar", (0.2, 0.4, 0.5, 0.5**0.5, 0.0, 0.0, 0.5**0.5)),
)


@dataclass(frozen=True)
class Run:
    """`frames` poses `step_m` apart; voxels within `reach_m` of the track. Imported labels have no features.

    With `has_confidence` the map has one, least near the limit of D². The frames have the grid `grid`; voxels of the
    map have the side `voxel_m`.
    """

    frames: int = 12
    reach_m: float = 5.0
    step_m: float = 0.6
    is_imported: bool = False
    has_confidence: bool = False
    grid: LabelGrid = PAPER
    voxel_m: float = MAP_VOXEL_M

    @cached_property
    def poses(self) -> Floats:
        """Return (F, 7): translation and quaternion wxyz; a gentle bend over the ground."""
        along = np.arange(self.frames) * self.step_m
        yaw = 0.03 * np.arange(self.frames)
        x, y = along, 0.05 * along**1.5
        zero = np.zeros_like(x)
        half = yaw / 2
        return np.stack([x, y, height_m(x, y), np.cos(half), zero, zero, np.sin(half)], axis=1)

    @cached_property
    def voxels(self) -> TileVoxels:
        """Return all voxels of the map, by index."""
        indices = np.unique(np.concatenate([self._ground(), _block(self.voxel_m)]), axis=0)
        features = features_at((indices + 0.5) * self.voxel_m)
        squared = distance_squared(features, REFERENCE)
        classes = np.where(squared <= LIMIT, 2, 3).astype(np.uint8)
        classes[self._is_driven(indices)] = 1
        return TileVoxels(indices, classes, features, squared, self._confidence(squared, classes))

    @cached_property
    def grids(self) -> list[Grid]:
        """Return the label grid of each frame."""
        return [_cut(pose, self) for pose in self.poses]

    def _confidence(self, squared: Floats, classes: Grid) -> Grid:
        if not self.has_confidence:
            return np.zeros(len(classes), np.uint8)
        far = np.abs(np.log(np.maximum(squared, 1e-9) / LIMIT))
        return np.where(classes == 1, 255, np.rint(254 - 130 * np.exp(-far))).astype(np.uint8)

    def _ground(self) -> NDArray[np.int64]:
        farthest_m = self.reach_m + self.frames * self.step_m
        cells = np.arange(-int(self.reach_m / self.voxel_m) - 1, int(farthest_m / self.voxel_m))
        middles = (cells + 0.5) * self.voxel_m
        x, y = (axis.ravel() for axis in np.meshgrid(middles, middles, indexing="ij"))
        gaps = np.hypot(x[:, None] - self.poses[:, 0], y[:, None] - self.poses[:, 1]).min(axis=1)
        x, y = x[gaps <= self.reach_m], y[gaps <= self.reach_m]
        return np.floor(np.stack([x, y, height_m(x, y)], axis=1) / self.voxel_m).astype(np.int64)

    def _is_driven(self, indices: NDArray[np.int64]) -> NDArray[np.bool_]:
        centre = (indices[:, :2] + 0.5) * self.voxel_m
        gaps = np.linalg.norm(centre[:, None] - self.poses[None, :, :2], axis=2).min(axis=1)
        return np.asarray(gaps <= 0.45)


def height_m(x: Floats, y: Floats) -> Floats:
    return np.asarray(0.35 * np.sin(x / 4.1) * np.cos(y / 5.3) + 0.006 * y**2)


def features_at(points: Floats) -> Floats:
    """Return (K, 3): elevation, slope, roughness of the formula at points (K, 3)."""
    x, y = points[:, 0], points[:, 1]
    step = 1e-4
    dx = (height_m(x + step, y) - height_m(x - step, y)) / (2 * step)
    dy = (height_m(x, y + step) - height_m(x, y - step)) / (2 * step)
    slope = np.arctan(np.hypot(dx, dy))
    slope[_is_block(points)] = np.pi / 2
    return np.stack([points[:, 2], slope, -9.6 + 1.2 * np.sin(2.1 * x) * np.sin(1.7 * y)], axis=1)


def _is_block(points: Floats) -> NDArray[np.bool_]:
    x, y = points[:, 0], points[:, 1]
    low_x, low_y, high_x, high_y, _ = BLOCK_M
    above = points[:, 2] > height_m(x, y) + MAP_VOXEL_M / 2
    return (x >= low_x) & (x < high_x) & (y >= low_y) & (y < high_y) & above


def _block(voxel_m: float) -> NDArray[np.int64]:
    low_x, low_y, high_x, high_y, high = BLOCK_M
    ranges = [
        np.arange(round(a / voxel_m), round(b / voxel_m)) for a, b in ((low_x, high_x), (low_y, high_y), (0, high))
    ]
    return np.stack(np.meshgrid(*ranges, indexing="ij"), axis=-1).reshape(-1, 3)


def _cut(pose: Floats, run: Run) -> Grid:
    """Return the grid around the pose: each voxel has the class of the map voxel that contains its centre.

    A voxel larger than the map's has the highest class of the map voxels that contain the centres of its parts.
    """
    voxels, grid = run.voxels, run.grid
    w, z = pose[3], pose[6]
    cos, sin = w * w - z * z, 2 * w * z
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    low = voxels.indices.min(axis=0) - 1
    held = np.zeros(voxels.indices.max(axis=0) + 2 - low, np.uint8)
    held[tuple((voxels.indices - low).T)] = voxels.classes
    parts = round(grid.voxel_m / run.voxel_m)
    fine = np.indices([size * parts for size in grid.shape], np.int16)
    centres = (np.moveaxis(fine, 0, -1) + 0.5) * (grid.voxel_m / parts) + grid.min_m
    index = np.floor((centres @ turn.T + pose[:3]) / run.voxel_m).astype(np.int64) - low
    index = np.clip(index, 0, np.array(held.shape) - 1)  # its border is empty
    x, y, z = grid.shape
    classes = held[tuple(np.moveaxis(index, -1, 0))].reshape(x, parts, y, parts, z, parts)
    return np.ascontiguousarray(classes.max(axis=(1, 3, 5)))


def observed_of(grid: Grid) -> Grid:
    """Return the LiDAR's observed mask: everything but a wedge to the left behind the robot."""
    across, along, _ = grid.shape
    x, y = np.meshgrid(np.arange(across) - across // 2, np.arange(along) - along // 2, indexing="ij")
    seen = ~((y > 6) & (x < -4))
    return np.broadcast_to(seen[..., None], grid.shape).astype(np.uint8).copy()


def viewed(
    platform: Platform,
    owner: Person,
    run: Run | None = None,
    *,
    has_clouds: bool = False,
    has_cameras: bool = False,
    name: str = "rolling-meadow",
) -> dict[str, Any]:
    """Create a sequence of the run with labels and a scene as the labeler does; return its id, name and tokens."""
    run = run or Run()
    with platform.database.transaction() as session:
        row = SequenceRow(owner_id=owner.user_id, name=name, environment="meadow", illumination="day")
        session.add(row)
        session.flush()
        facts = {"id": row.id, "name": row.name, "owner_id": owner.user_id}
    labels = made.labels(platform, facts, seed=row.id.encode(), contents=_label_files(run))
    tokens = list(labels.frames)
    _replace_scene(platform, labels.id, scene_files(facts["name"], tokens, run))
    if has_clouds or has_cameras:
        files = {cloud_file(token): _cloud(run, number) for number, token in enumerate(tokens) if has_clouds}
        files |= camera_files(tokens) if has_cameras else {}
        files |= {radar_file(token): _radar(number) for number, token in enumerate(tokens) if has_clouds}
        cameras = tuple(CHANNELS) if has_cameras else ()
        shown = PlaybackChannels(cameras, has_clouds, has_cameras, SENSORS, has_clouds)
        played(platform, owner, facts["id"], {**files, INDEX: index_record(shown)})
    return {**facts, "tokens": tokens, "label_set_id": labels.id}


def scene_files(name: str, tokens: list[str], run: Run) -> dict[str, bytes]:
    """Return `scene/…` as the labeler writes it: one tile and its surface."""
    voxels = run.voxels
    low, high = voxels.indices.min(axis=0) * run.voxel_m, (voxels.indices.max(axis=0) + 1) * run.voxel_m
    if run.is_imported:
        voxels = replace(voxels, features=voxels.features * np.nan, distance_squared=voxels.distance_squared * np.nan)
    tile, mesh = tile_bytes(voxels), mesh_bytes(_surface(run, low))
    extent = {"min_m": [round(v, 4) for v in low.tolist()], "max_m": [round(v, 4) for v in high.tolist()]}
    record = json.loads(made.scene_json(name, tokens)) | {
        "reference": {
            "mean": REFERENCE.mean.tolist(),
            "covariance": REFERENCE.covariance.tolist(),
            "d2_limit": LIMIT,
            "features": ["elevation_m", "slope_rad", "roughness"],
        },
        "tiles": [{"name": "0_0", **extent, "voxels": len(voxels.classes), "bytes": len(tile)}],
        "meshes": [{"name": "0_0", "triangles": 2 * 40 * 40, "bytes": len(mesh)}],
    }
    record["has_confidence"] = run.has_confidence
    if run.grid != PAPER:  # otherwise like scenes of earlier releases, whose maps name no voxel
        record |= {"grid": {key: run.grid.as_record()[key] for key in record["grid"]}, "map_voxel_m": run.voxel_m}
    if run.is_imported:
        record |= {"reference": None, "profile": "imported"}
    stamps = [str(made.START_NS + number * FRAME_NS) for number in range(len(tokens))]
    record["frames"] = {"tokens": tokens, "stamps_ns": stamps, "map_from_ego": run.poses.tolist()}
    return {
        "scene/scene.json": json.dumps(record).encode(),
        "scene/tile_0_0.bin": tile,
        "scene/mesh_0_0.bin": mesh,
    }


def _surface(run: Run, low: Floats) -> TileMesh:
    side, cells = 41, 40
    span = np.linspace(-run.reach_m, run.reach_m, side)
    x, y = np.meshgrid(span, span, indexing="ij")
    vertices = np.stack([x, y, height_m(x, y)], axis=-1).reshape(-1, 3)
    squared = distance_squared(features_at(vertices), REFERENCE)
    corner = (np.arange(cells)[:, None] * side + np.arange(cells)).ravel()
    lower = np.stack([corner, corner + side, corner + 1], axis=1)
    upper = np.stack([corner + 1, corner + side, corner + side + 1], axis=1)
    return TileMesh(vertices - low, np.where(squared <= LIMIT, 2, 3).astype(np.uint8), np.concatenate([lower, upper]))


def _cloud(run: Run, number: int) -> bytes:
    random = np.random.default_rng(number)
    flat = random.uniform(-run.reach_m, run.reach_m, (4000, 2))
    x, y, z = run.poses[number, :3]
    up = height_m(flat[:, 0] + x, flat[:, 1] + y) - z
    return cloud_bytes(np.column_stack([flat, up]), random.uniform(0, 255, 4000))


def radar_of(number: int) -> tuple[Floats, Floats]:
    """Return points (N, 3) of the ego frame and their speeds over ground; later frames have more, faster points."""
    count = 3 + number
    return np.column_stack([np.arange(count) + 2.0, np.full(count, 1.5), np.full(count, 0.8)]), np.arange(count) * -1.25


def _radar(number: int) -> bytes:
    return detections_bytes(*radar_of(number))


@cache
def _label_files(run: Run) -> list[bytes]:
    """Return the label file of each frame, cached for all tests of a process."""
    return [_labels(grid) for grid in run.grids]


def _labels(grid: Grid) -> bytes:
    seen = observed_of(grid)
    return npz_bytes({"semantics": grid, "mask_lidar": seen, "mask_camera": seen})


def _replace_scene(platform: Platform, label_set_id: str, files: dict[str, bytes]) -> None:
    """Replace the scene files that `made.labels` creates."""
    with platform.database.transaction() as session:
        session.get_one(LabelSet, label_set_id)
        laid = select(Artefact).where(Artefact.label_set_id == label_set_id, Artefact.name.startswith("scene/"))
        for row in session.scalars(laid):
            session.delete(row)
        session.flush()
        for name, content in files.items():
            made._artefact(session, platform, label_set_id, name, content)
