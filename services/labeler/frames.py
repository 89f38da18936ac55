"""Stage 3, per part: crop the label grid of every frame from the labelled map, as the bytes of `labels.npz`."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from threading import get_ident
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.labeler.parameters import LabelParameters
from services.labeler.run import LabelRun, Part, Tile, tiles_across
from services.labeler.scratch import Arrays, load, surface_path, unpacked
from stone.geometry.lattice import VoxelTable, table_of
from stone.geometry.se3 import SE3
from stone.labels.column_deflate import deflated_columns
from stone.labels.columns import Columns, Words, reconcile, spread_out
from stone.labels.confidence import CALIBRATED, confidence_of, properties_of
from stone.labels.crops import cut_batch, cut_with_rows
from stone.labels.grid import Bounds, Window, frame_bounds, window_bytes, window_of
from stone.labels.late_voxels import FirstSeen, first_seen, late_columns
from stone.labels.observed_voxels import NOTHING, Observed, union
from stone.labels.pooling import pooled, pooled_further
from stone.labels.profiles import VoxelTerrain, distances
from stone.labels.sight_batches import LANES, SightBatch
from stone.labels.traversability import Reference, classify, threshold
from stone.labels.visibility import sight_lines
from stone.sensors.calibration import CameraIntrinsics, Vehicle
from stone_base.label_grid import LabelGrid
from stone_files.npz import npz_bytes

MAX_WINDOW_BYTES = 192 * 2**20
GRIDS = ("semantics", "mask_lidar", "mask_camera")
LATE = "late"
# Further arrays: D² as float16 (relative error up to 0.0005, saturating at its maximum), and the values for no surface.
MOST_SQUARED = float(np.finfo(np.float16).max)
NO_SURFACE, UNSURE = -1.0, 0


@dataclass(frozen=True, eq=False)
class FrameVoxelCounts:
    """Counts per frame of a part, in order.

    Voxels by class (n, 4), observed by LiDAR and by cameras (n, 2), and labelled voxels that close a gap (n,).
    """

    classes: NDArray[np.int64]
    observed: NDArray[np.int64]
    filled: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class LabelledFrame:
    """A finished frame: its token, the bytes of its `labels.npz`, its counts as in `FrameVoxelCounts`."""

    token: str
    payload: bytes
    classes: NDArray[np.int64]
    observed: NDArray[np.int64]
    filled: int


def labelled_frames(run: LabelRun, part: Part, reference: Reference) -> Iterator[LabelledFrame]:
    """Yield the frames of `part` in order, one at a time."""
    sight = _sight_of(run)
    for near in _near_together(run, part):
        labelled_map = _map_around(run, near, reference)
        for batch in _batches(near):
            yield from _labelled(run, batch, labelled_map, sight)


def _sight_of(run: LabelRun) -> SightBatch:
    """Return the fields of view of the run's cameras."""
    calibration = run.sequence.calibration
    cameras = tuple(
        (mount.intrinsics, (calibration.ego_from_lidar @ mount.lidar_from_sensor).wxyz_xyz.tobytes())
        for mount in calibration.of_kind("camera")
        if mount.intrinsics is not None
    )
    return _sight_in(cameras, run.parameters.grid, get_ident())


@lru_cache(maxsize=1)
def _sight_in(cameras: tuple[tuple[CameraIntrinsics, bytes], ...], grid: LabelGrid, _thread: int) -> SightBatch:
    """Return the cached fields of view: 30 ms per camera, 90 MB of work memory. Each thread has its own."""
    lines = (sight_lines(intrinsics, SE3(np.frombuffer(pose)), grid) for intrinsics, pose in cameras)
    return SightBatch(list(lines), grid)


def counts_of(frames: Sequence[LabelledFrame]) -> FrameVoxelCounts:
    """Return the counts of these frames; there is at least one."""
    filled = np.array([f.filled for f in frames])
    return FrameVoxelCounts(np.array([f.classes for f in frames]), np.array([f.observed for f in frames]), filled)


def _labelled(run: LabelRun, batch: Part, labelled_map: "_LabelledMap", sight: SightBatch) -> Iterator[LabelledFrame]:
    poses, shape = run.sequence.frames.map_from_ego, run.parameters.grid.shape
    # At least one sweep is carved from a frame up to its `later`.
    later = np.arange(*batch) + run.every(run.parameters.carve.every_frame)
    height, cuts = shape[2], labelled_map.cut(poses[slice(*batch)], later.tolist())
    names = (*GRIDS, LATE)
    grids = np.empty((len(names), *shape), np.uint8)  # reused for every frame: fresh pages cost more
    seen = sight.visible(np.stack([frame.columns.occupied for frame in cuts]))
    for token, frame, visible in zip(run.sequence.frames.tokens[slice(*batch)], cuts, seen, strict=True):
        columns = frame.columns
        masks = reconcile(columns, visible, height)
        layers: list[tuple[Words, Words | None]] = [(columns.ones, columns.twos)]
        layers += [(words, None) for words in (masks.observed, masks.visible, frame.late)]
        for (low, high), grid in zip(layers, grids, strict=True):
            spread_out(low, high, grid)
        packed = [deflated_columns(low, high, height) for low, high in layers]
        arrays: dict[str, NDArray[Any]] = {**dict(zip(names, grids, strict=True)), **frame.further}
        payload = npz_bytes(arrays, deflated=dict(zip(names, packed, strict=True)))
        yield LabelledFrame(token, payload, masks.by_class, masks.by_mask, columns.filled)


def _batches(part: Part) -> list[Part]:
    """Divide the part into as few batches as possible, of nearly equal size."""
    count = -(-(part[1] - part[0]) // LANES)
    ends = np.linspace(part[0], part[1], count + 1).round().astype(int).tolist()
    return list(pairwise(ends))


def _near_together(run: LabelRun, part: Part) -> list[Part]:
    """Split the part where its frames are so far apart that one dense window would exceed the memory."""
    if part[1] - part[0] == 1 or window_bytes(_bounds(run, part)) <= MAX_WINDOW_BYTES:
        return [part]
    middle = (part[0] + part[1]) // 2
    return _near_together(run, (part[0], middle)) + _near_together(run, (middle, part[1]))


def _bounds(run: LabelRun, part: Part) -> Bounds:
    return frame_bounds(run.sequence.frames.map_from_ego[slice(*part)], run.parameters.grid)


@dataclass(frozen=True, eq=False)
class _CutFrame:
    """The columns of one frame, its late voxels, and further arrays of its file by name."""

    columns: Columns
    late: Words
    further: Mapping[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class _LabelledMap:
    """The labelled map around some frames, which are cropped at `grid`.

    If confidence is requested, `table` maps voxels to rows (K,), and `further` has the further arrays (K + 1,) by name;
    the last value stands for no surface.
    """

    grid: LabelGrid
    window: Window
    first: FirstSeen
    table: VoxelTable | None
    further: Mapping[str, NDArray[Any]]

    def cut(self, map_from_ego: SE3, later: Sequence[int]) -> list[_CutFrame]:
        """Return the frames at these poses (F,); `later` has, for each frame, the first frame that counts as later."""
        if self.table is None:
            fine = cut_batch(self.window, map_from_ego, self.grid.on_map)
            return [self._cut_frame(fine[at], map_from_ego[at], frame, {}) for at, frame in enumerate(later)]
        frames = []
        for at, frame in enumerate(later):
            columns, rows = cut_with_rows(self.window, map_from_ego[at], self.table, self.grid.on_map)
            further = {name: values[rows] for name, values in self.further.items()}
            frames.append(self._cut_frame(columns, map_from_ego[at], frame, further))
        return frames

    def _cut_frame(self, fine: Columns, pose: SE3, later: int, further: Mapping[str, NDArray[Any]]) -> _CutFrame:
        columns = pooled(fine, self.grid)
        late = late_columns(fine, self.window, pose, (self.first, later), self.grid)
        return _CutFrame(
            columns, late, further if columns is fine else pooled_further(fine, columns, further, self.grid)
        )


@dataclass(frozen=True, eq=False)
class LabelledTile:
    """A tile from the surface stage with K voxels; `arrays` are all arrays of that stage.

    - `terrain`, `is_driven` of its voxels
    - `squared`: D² against the reference and the vehicle
    - `classes`, and `confidence` (None if the profile has none)
    """

    terrain: VoxelTerrain
    is_driven: NDArray[np.bool_]
    squared: NDArray[np.float64]
    classes: NDArray[np.uint8]
    confidence: NDArray[np.uint8] | None
    arrays: Arrays

    @property
    def mesh(self) -> Arrays:
        """Return its `vertices` (V, 3), their `vertex_features` (V, 3) and `triangles`, unpacked on each call."""
        return unpacked(self.arrays["mesh"])


def labelled_tile(run: LabelRun, tile: Tile, reference: Reference, with_confidence: bool = False) -> LabelledTile:
    """Return the tile with the class of each voxel, and with its confidence if requested."""
    arrays = load(surface_path(run, tile))
    terrain, is_driven = VoxelTerrain(arrays["keys"], arrays["terrain"]), arrays["is_driven"]  # type: ignore[arg-type]
    squared = squared_distances(run, terrain, reference, run.parameters)
    classes = classify(squared, is_driven, run.parameters.reference.alpha)  # type: ignore[arg-type]
    confidence = None
    if with_confidence and run.parameters.profile == CALIBRATED:
        confidence = confidence_of(properties_of(terrain, squared, reference, _limits(run, run.parameters)), classes)
    return LabelledTile(terrain, is_driven, squared, classes, confidence, arrays)  # type: ignore[arg-type]


def squared_distances(
    run: LabelRun, terrain: VoxelTerrain, reference: Reference, parameters: LabelParameters
) -> NDArray[np.float64]:
    """Return the D² (K,) of voxels against a reference and the run's vehicle, by the parameters' profile."""
    return distances(terrain, reference, parameters.rule, _limits(run, parameters))


def _limits(run: LabelRun, parameters: LabelParameters) -> tuple[Vehicle, float]:
    return run.sequence.calibration.vehicle, threshold(parameters.reference.alpha)


def _map_around(run: LabelRun, part: Part, reference: Reference) -> _LabelledMap:
    """Return the labelled map around the frames of a part, all of one map."""
    bounds, is_asked = _bounds(run, part), run.parameters.confidence
    keys, classes, squared = [np.zeros(0, np.int64)], [np.zeros(0, np.uint8)], [np.zeros(0)]
    confidence = [np.zeros(0, np.uint8)]
    seen = [NOTHING]
    for tile in tiles_across(run.parameters, bounds, run.map_of(part)):
        if not surface_path(run, tile).exists():
            continue
        labelled = labelled_tile(run, tile, reference, with_confidence=is_asked)
        keys.append(labelled.terrain.keys)
        classes.append(labelled.classes)
        squared.append(labelled.squared)
        confidence += [] if labelled.confidence is None else [labelled.confidence]
        bricks = (labelled.arrays[name] for name in ("bricks", "words", "since"))
        seen.append(Observed(*bricks))  # type: ignore[arg-type]
    all_keys = np.concatenate(keys)
    observed = union(seen)
    window = window_of(all_keys, np.concatenate(classes), observed, bounds)
    cut_from = (run.parameters.grid, window, first_seen(observed, window))
    if not is_asked:
        return _LabelledMap(*cut_from, None, {})
    all_squared = np.append(np.concatenate(squared), NO_SURFACE)
    further: dict[str, NDArray[Any]] = {"distance_squared": np.minimum(all_squared, MOST_SQUARED).astype(np.float16)}
    if run.parameters.profile == CALIBRATED:
        further["confidence"] = np.append(np.concatenate(confidence), np.uint8(UNSURE))
    return _LabelledMap(*cut_from, table_of(all_keys), further)
