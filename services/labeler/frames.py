"""Stage 3, per part: cut the label grid of every frame out of the labelled map and write `labels.npz`."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.labeler.run import Part, Run, Tile, core_cells
from services.labeler.scratch import Arrays, load, save, sight_path, surface_path
from services.runtime.npz import npz_bytes
from stone.grid import GRID_SHAPE, Grid, Window, crop, frame_bounds, reconcile, window_of
from stone.observed import Observed, union
from stone.traversability import Reference, classify
from stone.visibility import SightLines, mark_visible, sight_lines
from stone.voxels import VOXEL_M

MAX_WINDOW_BYTES = 192 * 2**20


@dataclass(frozen=True, eq=False)
class FrameCounts:
    """Per frame of a part, in order: voxels by class (n, 4), observed by LiDAR and by cameras (n, 2)."""

    classes: NDArray[np.int64]
    observed: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class LabelledFrame:
    """One frame done: its token, the bytes of its `labels.npz`, and its counts (4,) and (2,) as in `FrameCounts`."""

    token: str
    payload: bytes
    classes: NDArray[np.int64]
    observed: NDArray[np.int64]


def lay_sight_lines(run: Run, camera: int) -> None:
    """Lay out once per run what the calibration's camera of this number can see; nothing without its intrinsics."""
    mount = run.sequence.calibration.of_kind("camera")[camera]
    if mount.intrinsics is not None:
        lines = sight_lines(mount.intrinsics, run.sequence.calibration.ego_from_lidar @ mount.lidar_from_sensor)
        save(sight_path(run, camera), vars(lines))


def frames(run: Run, part: Part, reference: Reference, labels_root: Path) -> FrameCounts:
    """Write the labels of the frames of `part` under `labels_root`/<frame_token>/."""
    done = []
    for frame in labelled_frames(run, part, reference):
        _write(labels_root / frame.token / "labels.npz", frame.payload)
        done.append(replace(frame, payload=b""))
    return counts_of(done)


def labelled_frames(run: Run, part: Part, reference: Reference) -> Iterator[LabelledFrame]:
    """The frames of `part` in order, one at a time."""
    cameras = [
        SightLines(**load(path))  # type: ignore[arg-type]
        for path in sorted((run.scratch / "sight").glob("[0-9]*.npz"))
    ]
    for begin, end in _near_together(run, part):
        window = _window(run, frame_bounds(run.sequence.frames.map_from_ego[slice(begin, end)]), reference)
        for index in range(begin, end):
            yield _labelled(run, index, window, cameras)


def counts_of(frames: Sequence[LabelledFrame]) -> FrameCounts:
    """The counts of these frames; there is at least one."""
    return FrameCounts(np.array([f.classes for f in frames]), np.array([f.observed for f in frames]))


def _labelled(run: Run, index: int, window: Window, cameras: list[SightLines]) -> LabelledFrame:
    semantics, mask_lidar = crop(window, run.sequence.frames.map_from_ego[index])
    mask_camera = _seen(semantics, cameras)
    by_class, by_mask = reconcile(semantics, mask_lidar, mask_camera)
    grids = {"semantics": semantics, "mask_lidar": mask_lidar, "mask_camera": mask_camera}
    return LabelledFrame(run.sequence.frames.tokens[index], npz_bytes(grids), by_class, by_mask)


def _near_together(run: Run, part: Part) -> list[Part]:
    """The part cut where its frames lie so far apart that one dense window would not fit the memory."""
    low, high = frame_bounds(run.sequence.frames.map_from_ego[slice(*part)])
    if part[1] - part[0] == 1 or np.prod((high - low).astype(np.float64)) <= MAX_WINDOW_BYTES:
        return [part]
    middle = (part[0] + part[1]) // 2
    return _near_together(run, (part[0], middle)) + _near_together(run, (middle, part[1]))


def _seen(semantics: Grid, cameras: list[SightLines]) -> Grid:
    """What any camera sees past the labelled voxels."""
    visible = np.zeros(GRID_SHAPE, np.uint8)
    for lines in cameras:
        mark_visible(semantics, lines, visible)
    return visible


def labelled_tile(run: Run, tile: Tile, reference: Reference) -> tuple[Arrays, NDArray[np.uint8]]:
    """What the surface stage left of this tile, and the class of each of its voxels (K,)."""
    arrays = load(surface_path(run, tile))
    alpha = run.parameters.reference.alpha
    return arrays, classify(arrays["features"], arrays["is_driven"], reference, alpha)  # type: ignore[arg-type]


def _window(run: Run, bounds: tuple[NDArray[np.int64], NDArray[np.int64]], reference: Reference) -> Window:
    """The labelled map within a range of voxel indices."""
    low, high = bounds
    keys, classes = [np.zeros(0, np.int64)], [np.zeros(0, np.uint8)]
    seen = [Observed(np.zeros(0, np.int64), np.zeros(0, np.uint64))]
    for tile in tiles_between(run, low, high):
        arrays, kinds = labelled_tile(run, tile, reference)
        keys.append(arrays["keys"])  # type: ignore[arg-type]
        classes.append(kinds)
        seen.append(Observed(arrays["bricks"], arrays["words"]))  # type: ignore[arg-type]
    return window_of(np.concatenate(keys), np.concatenate(classes), union(seen), bounds)


def tiles_between(run: Run, low: NDArray[np.int64], high: NDArray[np.int64]) -> list[Tile]:
    """The reconstructed tiles that reach into a range of voxel indices."""
    cells = core_cells(run.parameters, VOXEL_M)
    first, last = low[:2] // cells, (high[:2] - 1) // cells
    around = [(int(i), int(j)) for i in range(first[0], last[0] + 1) for j in range(first[1], last[1] + 1)]
    return [tile for tile in around if surface_path(run, tile).exists()]


def _write(path: Path, payload: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(payload)
