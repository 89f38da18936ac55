"""A twin of the released dataset: ZIP, tables, sweeps and labels by the table of layouts, in a small hilly world.

**Conventions.** Only `stone_files/dataset_layouts.py` determines the layout, so the same world can be written in any
layout. Scenes are chunks of drives. The ground is a formula of global x and y, with boxes on it. A return is a point of
a surface, a voxel is occupied if a surface passes through it, and voxels below the ground are unknown. The LiDAR is
turned by a quarter and tilted. Beside the tables lie boxes, with a key outside the schema, and a pickle that no program
may open.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial
from pathlib import Path
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone_base.label_grid import LabelGrid
from stone_files.dataset_layouts import LAYOUTS, RELEASE_FACTS, DatasetLayout, dashed_token
from stone_files.npz import npz_bytes
from testing.worlds.published_datasets import (
    FIRST_US,
    VERSION,
    Row,
    SyntheticDataset,
    pose_of,
    tables_of,
)
from testing.worlds.small_export import picture_of
from testing.worlds.zip_stream import zip_stream

SWEEP_SHOTS, NO_RETURN_SHARE, REACH_M = 6_000, 0.25, 38.0
FARTHEST_M = 100.0  # outside every grid
EGO_FROM_LIDAR = SE3.from_parts(np.array([0.69, 0.06, 0.04, -0.72]), np.array([0.16, 0.12, 0.54]))
MOST_POSES = 1_000  # number of poses whose sweeps and labels are cached
BOX_CELL_M, BOX_HALF_M, BOX_HIGH_M = 9.0, 0.8, 1.9
PICKLE = b"\x80\x04cposix\nsystem\n\x94."
CAMERAS = ("CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_LEFT", "CAM_BACK", "CAM_BACK_RIGHT")
TOKENS_OF_SAMPLES = {
    "sample": ("token", "prev", "next"),
    "scene": ("first_sample_token", "last_sample_token"),
    "sample_data": ("sample_token",),
    "sample_annotation": ("sample_token",),
}
Points = NDArray[np.float64]
RowChange = Callable[[str, Row], Row]


@dataclass(frozen=True)
class ReleasedDataset:
    """The dataset to write: `scenes` of `frames`, grouped into drives, in the layout of this name.

    Drives share the places of the release evenly, in their order; places lie `apart_m` apart. After `turns_after`
    frames the robot drives back and forth again, so sweeps and labels repeat; 0: without turning. The LiDAR reaches
    `reach_m`, and nothing beyond is labelled. `labels_in` is a grid for labels other than the layout's. `changed`
    alters rows of tables at the end.
    """

    scenes: int = 2
    frames: int = 4
    layout: DatasetLayout = LAYOUTS["release"]
    cameras: tuple[str, ...] = CAMERAS[:1]
    labels_in: LabelGrid | None = None
    changed: RowChange = field(default=lambda _table, row: row)
    is_deflated: bool = True
    drive_scenes: int = 2
    turns_after: int = 0
    apart_m: float = 0.0
    reach_m: float = FARTHEST_M

    @cached_property
    def tables(self) -> SyntheticDataset:
        """Its scenes, frames and sensors."""
        logs, drives = RELEASE_FACTS.logs, -(-self.scenes // self.drive_scenes)
        locations = [logs[scene // self.drive_scenes * len(logs) // drives] for scene in range(self.scenes)]
        return SyntheticDataset(
            self.scenes, self.frames, cameras=self.cameras, radars=(), locations=locations,
            drive_scenes=self.drive_scenes, turns_after=self.turns_after, apart_m=self.apart_m,
        )  # fmt: skip

    @property
    def root(self) -> str:
        return f"{self.layout.roots[0]}/" if self.layout.roots else ""

    def written(self, token: str) -> str:
        """Return a frame token as the layout writes it."""
        return dashed_token(token) if self.layout.has_dashes and token else token


def write_released_zip(path: Path, what: ReleasedDataset) -> Path:
    """Write the dataset as one ZIP; if the robot drives back and forth, memory does not grow with its frames."""
    with zip_stream(path, is_deflated=what.is_deflated) as archive:
        for name, pieces in _table_files(what):
            archive.add_pieces(f"{what.root}{name}", pieces)
        for name, content in _other_files(what):
            archive.add(f"{what.root}{name}", content)
    return path


def write_released(folder: Path, what: ReleasedDataset) -> Path:
    """Write the dataset as a folder."""
    for name, content in released_files(what):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


def released_files(what: ReleasedDataset) -> Iterator[tuple[str, bytes]]:
    """Yield every file by its name below the root."""
    yield from ((name, b"".join(pieces)) for name, pieces in _table_files(what))
    yield from _other_files(what)


def _table_files(what: ReleasedDataset) -> Iterator[tuple[str, Iterator[bytes]]]:
    for table, rows in released_tables(what).items():
        yield f"{VERSION}/{table}.json", _table_text(map(partial(what.changed, table), rows))


def _table_text(rows: Iterator[Row]) -> Iterator[bytes]:
    begin = "[\n"
    for row in rows:
        yield f"{begin}{json.dumps(row)}".encode()
        begin = ",\n"
    yield b"\n]\n"


def _other_files(what: ReleasedDataset) -> Iterator[tuple[str, bytes]]:
    yield "nuscenes_infos_val.pkl", PICKLE
    tables, picture, seen_at = what.tables, picture_of(FIRST_US, "CAM"), lru_cache(MOST_POSES)(partial(_seen_at, what))
    for scene, name in enumerate(tables.names):
        for frame, token in enumerate(tables.tokens(scene)):
            stamp_us = tables.stamp_us(scene, frame)
            pose = pose_of(tables, scene, stamp_us)
            sweep, labels = seen_at((*pose["rotation"], *pose["translation"]))
            yield tables.filename("LIDAR_TOP", stamp_us), sweep
            for camera in what.cameras:
                yield tables.filename(camera, tables.datum_us(scene, frame, camera)), picture
            yield f"gts/{name}/{what.written(token)}/labels.npz", labels


def _seen_at(what: ReleasedDataset, numbers: tuple[float, ...]) -> tuple[bytes, bytes]:
    """Return the sweep and the labels at a pose."""
    pose = SE3.from_parts(np.array(numbers[:4]), np.array(numbers[4:]))
    sweep = sweep_of(pose, seed=crc32(repr(numbers).encode()), layout=what.layout, reach_m=what.reach_m)
    return sweep, labels_of(pose, what.labels_in or what.layout.grid, what.layout, what.reach_m)


def released_tables(what: ReleasedDataset) -> Mapping[str, Iterator[Row]]:
    """Return the rows of every table, with tokens of samples as the layout writes them."""
    tables = dict(tables_of(what.tables)) | {"sample_annotation": _boxes(what), "instance": iter([_INSTANCE])}
    return {name: map(partial(_written, what, name), rows) for name, rows in tables.items()}


_INSTANCE: Row = {"token": "0" * 32, "category_token": "", "nbr_annotations": 1}


def _boxes(what: ReleasedDataset) -> Iterator[Row]:
    for scene, name in enumerate(what.tables.names):
        for token in what.tables.tokens(scene):
            yield {
                "token": f"box-{name}-{token}", "sample_token": token, "instance_token": _INSTANCE["token"],
                "translation": [1.0, 2.0, 0.5], "size": [1.0, 1.0, 1.0], "rotation": [1.0, 0.0, 0.0, 0.0],
                "bbox_2d": [[0, 0, 10, 10]],
            }  # fmt: skip


def _written(what: ReleasedDataset, table: str, row: Row) -> Row:
    row = row | {key: what.written(row[key]) for key in TOKENS_OF_SAMPLES.get(table, ())}
    if table == "calibrated_sensor" and not row["camera_intrinsic"]:
        row |= {"rotation": EGO_FROM_LIDAR.wxyz.tolist(), "translation": EGO_FROM_LIDAR.translation_m.tolist()}
    return row


# The world: heights above the ego origins' plane, which is at a global z of 50 m.


def ground_m(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the height of the ground at global points."""
    return np.asarray(0.13 + 0.33 * np.sin(x / 5) + 0.21 * np.sin(y / 7 + x / 13))


def box_centres(pose: SE3) -> Points:
    """Return global x and y (N, 2) of the boxes around a pose: one in every cell, moved by a formula."""
    x, y, _ = pose.translation_m
    cells = np.stack(np.meshgrid(np.arange(-6, 7), np.arange(-6, 7), indexing="ij"), axis=-1).reshape(-1, 2)
    cells = cells + np.floor(np.array([x, y]) / BOX_CELL_M).astype(int)
    moved = np.stack(
        [np.sin(cells[:, 0] * 12.9 + cells[:, 1] * 78.2), np.cos(cells[:, 0] * 39.3 - cells[:, 1])], axis=1
    )
    centres: Points = (cells + 0.5 + 0.3 * moved) * BOX_CELL_M
    is_away: NDArray[np.bool_] = np.linalg.norm(centres - (x, y), axis=1) > 4.0
    return centres[is_away]


def box_points(centres: Points, around: NDArray[np.float64], up: NDArray[np.float64]) -> Points:
    """Return global points (N, 3) of the sides of boxes: `around` (N,) in [0, 4), height share `up` (N,)."""
    side, along = around.astype(int), (around % 1 * 2 - 1) * BOX_HALF_M
    x = np.choose(side, [along, np.full_like(along, BOX_HALF_M), -along, np.full_like(along, -BOX_HALF_M)])
    y = np.choose(side, [np.full_like(along, -BOX_HALF_M), along, np.full_like(along, BOX_HALF_M), -along])
    low = ground_m(centres[:, 0], centres[:, 1])
    return np.stack([centres[:, 0] + x, centres[:, 1] + y, 50.0 + low + up * BOX_HIGH_M], axis=1)


def sweep_of(pose: SE3, *, seed: int, layout: DatasetLayout, reach_m: float) -> bytes:
    """Return the file of a sweep at a pose: a row for every shot if the layout has those, else for every return."""
    random = np.random.default_rng(seed)
    low, count = SWEEP_SHOTS * 2 // 3, SWEEP_SHOTS // 3
    away_m, angle = REACH_M * random.uniform(0.06, 1, low), random.uniform(0, 2 * np.pi, low)
    x, y = pose.translation_m[0] + away_m * np.cos(angle), pose.translation_m[1] + away_m * np.sin(angle)
    ground = np.stack([x, y, 50.0 + ground_m(x, y)], axis=1)
    centres = box_centres(pose)
    sides = box_points(
        centres[random.integers(0, len(centres), count)], random.uniform(0, 4, count), random.uniform(0.02, 0.98, count)
    )
    points = EGO_FROM_LIDAR.inverse() @ (pose.inverse() @ np.concatenate([ground, sides]))
    rows = np.concatenate([points, random.uniform(0, 255, (len(points), 1)), np.zeros((len(points), 1))], axis=1)
    is_lost = (random.uniform(size=len(rows)) < NO_RETURN_SHARE) | (np.linalg.norm(points, axis=1) > reach_m)
    if layout.has_no_returns:
        rows[is_lost, :3] = np.nan
    return np.asarray(rows if layout.has_no_returns else rows[~is_lost], "<f4").tobytes()


def labels_of(pose: SE3, grid: LabelGrid, layout: DatasetLayout, reach_m: float) -> bytes:
    """Return labels.npz at a pose, which is turned about z alone, with the keys and values of the layout."""
    classes = np.zeros(grid.shape, np.uint8)
    x, y = (grid.min_m[at] + np.arange(0.01, grid.shape[at] * grid.voxel_m, grid.voxel_m / 5) for at in (0, 1))
    ego = np.stack(
        [*(axis.reshape(-1) for axis in np.meshgrid(x, y, indexing="ij")), np.zeros(len(x) * len(y))], axis=1
    )
    placed = pose @ ego
    ego[:, 2] = ground_m(placed[:, 0], placed[:, 1])
    _mark(classes, grid, ego, np.where(np.abs(ego[:, 1]) < 2, 1, 2).astype(np.uint8))
    centres = box_centres(pose)
    around, up = (axis.reshape(-1) for axis in np.meshgrid(np.arange(0, 4, 0.03), np.arange(0, 1, 0.02), indexing="ij"))
    for centre in centres:
        sides = pose.inverse() @ box_points(np.broadcast_to(centre, (len(around), 2)), around, up)
        _mark(classes, grid, sides, np.full(len(sides), 3, np.uint8))
    middles = [grid.min_m[at] + grid.voxel_m * (np.arange(grid.shape[at]) + 0.5) for at in (0, 1)]
    classes[np.hypot(*np.meshgrid(*middles, indexing="ij")) > reach_m + 1] = 0
    is_known = np.logical_or.accumulate(classes > 0, axis=2)
    if layout.has_masks:
        seen = is_known.astype(np.uint8)
        return npz_bytes({layout.label_key: classes, "mask_lidar": seen, "mask_camera": seen})
    return npz_bytes({layout.label_key: np.where(is_known, classes, np.uint8(layout.grid.unknown or 255))})


def _mark(classes: NDArray[np.uint8], grid: LabelGrid, points: Points, values: NDArray[np.uint8]) -> None:
    places = np.floor((points - grid.min_m) / grid.voxel_m).astype(np.int64)
    is_in = ((places >= 0) & (places < grid.shape)).all(axis=1)
    i, j, k = places[is_in].T
    classes[i, j, k] = values[is_in]


def with_quaternions_last(table: str, row: Row) -> Row:
    """Return a row whose rotation is written x y z w."""
    return row | ({"rotation": [*row["rotation"][1:], row["rotation"][0]]} if "rotation" in row else {})


def of_tables(change: Callable[[Row], Row], *tables: str) -> RowChange:
    """Return a change that applies only to rows of these tables."""
    return lambda table, row: change(row) if table in tables else row
