"""Intermediate results of stages: arrays in files that appear atomically.

**Conventions.** A file is written under a temporary name and renamed, so a killed worker leaves no partial file and a
stage that runs twice writes the same bytes. The outputs of a stage are the files recorded by `whole`. All files are
deleted when the run ends. In the queue, files that no tile needs any more are deleted earlier
(`services/labeler/spent_files.py`).
"""

from bisect import bisect_right
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from io import BytesIO
from itertools import groupby
from pathlib import Path
from secrets import token_hex

import numpy as np
from numpy.typing import NDArray

from services.labeler.map.fused_files import fused_observed, fused_points
from services.labeler.run import LabelRun, Part, Tile, parts_of
from stone.labels.observed_voxels import NOTHING, Observed, union
from stone.surface.pointmap import PointMap
from stone.surface.range_image import RangeImage, view_of
from stone_files.npz import mapped_npz, npz_bytes, write_stored_npz

Arrays = dict[str, NDArray[np.generic]]
FUSED, IMAGES, FIRST_ROW = "fused", "images", "first_row"
_WRITTEN: ContextVar[list[Path] | None] = ContextVar("the files that a stage wrote", default=None)


def save(path: Path, arrays: Arrays) -> None:
    """Write arrays to `path` (.npz, stored), atomically."""
    with whole(path) as staging, staging.open("wb") as file:
        write_stored_npz(file, arrays)


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Yield a temporary path, which is renamed to `path` at the end; two concurrent writers do not collide."""
    path.parent.mkdir(parents=True, exist_ok=True)
    staging = path.with_name(f".{path.name}.{token_hex(8)}")
    try:
        yield staging
        staging.replace(path)
        if (written := _WRITTEN.get()) is not None:
            written.append(path)
    finally:
        staging.unlink(missing_ok=True)


@contextmanager
def recorded_writes() -> Iterator[list[Path]]:
    """Yield the list of paths that `whole` puts in place meanwhile, in this thread."""
    written = list[Path]()
    token = _WRITTEN.set(written)
    try:
        yield written
    finally:
        _WRITTEN.reset(token)


def load(path: Path) -> Arrays:
    """Return the arrays saved at `path`, memory-mapped, so that unused arrays are not read."""
    return mapped_npz(path)


def packed(arrays: Arrays) -> NDArray[np.uint8]:
    """Return the arrays deflated as one array for `save`: they are read once, and many of their bytes repeat."""
    return np.frombuffer(npz_bytes(arrays), np.uint8)


def unpacked(content: NDArray[np.generic]) -> Arrays:
    """Return the arrays from `packed`."""
    with np.load(BytesIO(content.data), allow_pickle=False) as arrays:
        return dict(arrays)


def fused_path(run: LabelRun, tile: Tile, part: Part) -> Path:
    return run.scratch / FUSED / tile_name(tile) / part_file(part)


def images_path(run: LabelRun, part: Part) -> Path:
    return run.scratch / IMAGES / part_file(part)


def part_file(part: Part) -> str:
    """Return the file name of a part's output in a folder."""
    return f"{part[0]:06d}.npz"


def surface_path(run: LabelRun, tile: Tile) -> Path:
    return run.scratch / "surface" / f"{tile_name(tile)}.npz"


def tile_name(tile: Tile) -> str:
    """Return the name of a tile; without the map for the first map, the only map of an unbroken run."""
    return f"{tile.i}_{tile.j}_{tile.map}" if tile.map else f"{tile.i}_{tile.j}"


def tile_named(name: str) -> Tile:
    """Return the tile whose folder or file (without its suffix) has this name."""
    return Tile(*map(int, name.split("_")))


def load_points(run: LabelRun, tile: Tile, low: NDArray[np.float64], high: NDArray[np.float64]) -> list[PointMap]:
    """Return the point maps of this tile, part by part, with voxel centres in [low, high) (2,) in plan."""
    voxel_m = run.parameters.surface.point_voxel_m
    first, end = (np.ceil(bound / voxel_m - 0.5).astype(np.int64) for bound in (low, high))
    return [fused_points(load(path), voxel_m, (first, end)) for path in _fused_parts(run, tile)]


def load_observed(run: LabelRun, tile: Tile) -> Observed:
    """Return the voxels of this tile observed in any part."""
    return union([NOTHING, *(fused_observed(load(path)) for path in _fused_parts(run, tile))])


def save_images(run: LabelRun, part: Part, images: Mapping[int, NDArray[np.float32]]) -> None:
    """Write the range images (rows, columns) of the part's frames, without empty rows at the edges."""
    seen = np.flatnonzero(np.any([image.any(axis=1) for image in images.values()], axis=0))
    first, last = (int(seen[0]), int(seen[-1]) + 1) if len(seen) else (0, 0)
    cut: Arrays = {image_name(index): image[first:last] for index, image in images.items()}
    save(images_path(run, part), {FIRST_ROW: np.array(first), **cut})


def images_near(
    run: LabelRun, number: int, low: NDArray[np.float64], high: NDArray[np.float64]
) -> Iterator[list[RangeImage]]:
    """Yield the range images of a map taken within reach of the box [low, high] (3,), one part at a time.

    The selection depends only on the run's poses, never on the parts that are already fused.
    """
    poses = run.sequence.frames.map_from_ego
    for part, indices in _by_part(run, imaged_near(run, number, low, high)):
        images, views = load(images_path(run, part)), view_of(poses[np.array(indices)], run.sensor_ego)
        first = int(images[FIRST_ROW].item())
        whole = [np.zeros(run.parameters.dynamic.shape, np.float32) for _ in indices]
        for image, index in zip(whole, indices, strict=True):
            cut = images[image_name(index)]
            image[first : first + len(cut)] = cut
        yield [RangeImage(views[at], image) for at, image in enumerate(whole)]


def imaged_near(run: LabelRun, number: int, low: NDArray[np.float64], high: NDArray[np.float64]) -> list[int]:
    """Return the frames of a map, in order, with a range image within reach of the box [low, high] (3,)."""
    dynamic, poses = run.parameters.dynamic, run.sequence.frames.map_from_ego
    indices = np.arange(0, len(poses), run.every(dynamic.every_frame))
    indices = indices[run.maps[indices] == number]
    places = poses[indices] @ run.sensor_ego
    gaps = np.maximum(0.0, np.maximum(low - places, places - high))
    return [int(index) for index in indices[np.linalg.norm(gaps, axis=1) < dynamic.max_range_m]]


def image_name(index: int) -> str:
    """Return the name of this frame's range image in the file of its part."""
    return f"{index:06d}"


def _by_part(run: LabelRun, indices: list[int]) -> Iterator[tuple[Part, list[int]]]:
    """Yield these frames, in order, by the part that fused them."""
    parts = parts_of(run)
    begins = [part[0] for part in parts]
    for at, mine in groupby(indices, lambda index: bisect_right(begins, index) - 1):
        yield parts[at], list(mine)


def _fused_parts(run: LabelRun, tile: Tile) -> list[Path]:
    return sorted((run.scratch / FUSED / tile_name(tile)).glob("[0-9]*.npz"))
