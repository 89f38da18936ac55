"""A torch dataset over cached frames: the frame, earlier sweeps of its sequence, augmented, and batches of these.

**Conventions.** As in `baselines/batch.py`. An item is drawn by (epoch, index); its content depends on these and the
seed only, not on the worker. Earlier sweeps are transformed by the poses; later sweeps are never used.
"""

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import Dataset, Sampler

from baselines.augment import (
    NO_AUGMENTATION,
    AugmentConfig,
    GridMirrors,
    changed_picture,
    draw_mirrors,
    draw_picture_change,
    generator_of,
)
from baselines.batch import IGNORED, Batch, CameraViews, Points
from baselines.frame_record import FrameRecord
from baselines.inputs import CountedVoxels, InputConfig
from baselines.lattice import VoxelLattice, grid_part
from stone_base.label_grid import PAPER, LabelGrid
from stone_exports.labels import NOT_OBSERVED, UNSURE

Draw = tuple[int, int]
RECORDS_KEPT = 24


class FrameStore(Protocol):
    """Frames in order of sequence and stamp, each read on demand: from a cache, or from exports."""

    def __len__(self) -> int: ...

    def key(self, index: int) -> tuple[str, int]:
        """Return the sequence and the stamp in microseconds."""
        ...

    def read(self, index: int) -> FrameRecord: ...


@dataclass(frozen=True, eq=False)
class FrameRequest:
    """The required content of frames: the row's inputs and lattice, the augmentation, the counted voxels, and the grid
    of the labels.
    """

    inputs: InputConfig
    lattice: VoxelLattice
    augment: AugmentConfig = NO_AUGMENTATION
    seed: int = 0
    counted: CountedVoxels = "all"
    grid: LabelGrid = PAPER


class FrameDataset(Dataset[Batch]):
    """Batches of one frame each, by (epoch, index)."""

    def __init__(self, store: FrameStore, request: FrameRequest) -> None:
        self.store, self.request = store, request
        self._records = OrderedDict[int, FrameRecord]()

    def __len__(self) -> int:
        return len(self.store)

    def __getitem__(self, draw: Draw) -> Batch:
        epoch, index = draw
        inputs, rng = self.request.inputs, generator_of(self.request.seed, epoch, index)
        record = self._record(index)
        mirrors = draw_mirrors(self.request.augment, rng)
        return Batch(
            tokens=(record.token,),
            grid_from_ego=torch.from_numpy(mirrors.grid_from_ego()).float()[None],
            cameras=self._cameras(record, rng) if inputs.sees("C") else None,
            lidar=self._lidar(index, mirrors) if inputs.sees("L") else None,
            radar=self._radar(index, mirrors) if inputs.sees("R") else None,
            labels=self._labels(record, mirrors),
        )

    def _record(self, index: int) -> FrameRecord:
        """Return the frame, which stays in memory for later frames."""
        if index not in self._records:
            self._records[index] = self.store.read(index)
            if len(self._records) > RECORDS_KEPT:
                self._records.popitem(last=False)
        return self._records[index]

    def _earlier(self, index: int, most: int) -> Iterator[tuple[FrameRecord, float]]:
        """Yield the frame and earlier frames of its sequence, with their ages in seconds, newest first."""
        sequence, stamp_us = self.store.key(index)
        for position in range(index, max(index - most, -1), -1):
            name, then_us = self.store.key(position)
            age_s = (stamp_us - then_us) / 1e6
            if name != sequence or age_s > self.request.inputs.earliest_s:
                return
            yield self._record(position), age_s

    def _lidar(self, index: int, mirrors: GridMirrors) -> Points:
        parts = [
            _placed(self._record(index), then, then.returns, age_s)
            for then, age_s in self._earlier(index, self.request.inputs.lidar_sweeps)
        ]
        return _points(np.concatenate(parts), mirrors)

    def _radar(self, index: int, mirrors: GridMirrors) -> Points:
        parts = [
            _placed(self._record(index), then, then.detections, age_s)
            for then, age_s in self._earlier(index, self.request.inputs.radar_scans)
        ]
        return _points(np.concatenate(parts), mirrors, turns_velocities=True)

    def _labels(self, record: FrameRecord, mirrors: GridMirrors) -> torch.Tensor | None:
        if record.labels is None:
            return None
        # The whole grid is mirrored, then cut: a part of it need not be symmetric about the robot.
        part = mirrors.of_labels(record.labels)[grid_part(self.request.lattice, self.request.grid)]
        if self.request.counted == "all":
            part = np.where(part == NOT_OBSERVED, np.uint8(0), part)
        part = np.where(part == UNSURE, np.uint8(IGNORED), part)
        return torch.from_numpy(part)[None]

    def _cameras(self, record: FrameRecord, rng: np.random.Generator) -> CameraViews:
        size_px = self.request.inputs.image_size_px
        changes = [draw_picture_change(self.request.augment, size_px, rng) for _ in record.pictures]
        if self.request.augment == NO_AUGMENTATION:
            changes = [np.eye(3) for _ in record.pictures]
        images = [
            changed_picture(picture.jpeg, change) for picture, change in zip(record.pictures, changes, strict=True)
        ]
        depths = self._depths(record, changes) if self.request.inputs.with_depth and record.labels is not None else None
        return CameraViews(
            torch.from_numpy(np.stack(images))[None],
            _stacked([picture.intrinsics for picture in record.pictures]),
            _stacked(changes),
            _stacked([picture.ego_from_camera for picture in record.pictures]),
            None if depths is None else torch.from_numpy(depths)[None],
        )

    def _depths(self, record: FrameRecord, changes: Sequence[NDArray[np.float64]]) -> NDArray[np.float32]:
        views = zip(record.pictures, changes, strict=True)
        matrices = [(change @ picture.intrinsics, np.linalg.inv(picture.ego_from_camera)) for picture, change in views]
        return np.stack(
            [depth_picture(record.returns[:, :3], *pair, self.request.inputs.image_size_px) for pair in matrices]
        )


class EpochSampler(Sampler[Draw]):
    """Yield (epoch, index) of all `indices`, or of this process's share; shuffled by seed and epoch with a seed.

    Shares have equal length: the remainder of an epoch is left out. `begin` skips the drawn items.
    """

    def __init__(self, indices: Sequence[int], seed: int | None = None, share: tuple[int, int] = (0, 1)) -> None:
        self._indices, self._seed, self._share = np.array(indices, np.int64), seed, share
        self.epoch, self.begin = 0, 0

    def __len__(self) -> int:
        return len(self._indices) // self._share[1]

    def __iter__(self) -> Iterator[Draw]:
        order = self._indices
        if self._seed is not None:
            order = np.random.default_rng((self._seed, self.epoch)).permutation(order)
        own = order[self._share[0] :: self._share[1]][: len(self)]
        yield from ((self.epoch, int(index)) for index in own[self.begin :])


def _placed(now: FrameRecord, then: FrameRecord, rows: NDArray[np.float32], age_s: float) -> NDArray[np.float32]:
    """Return rows (N, F) of an earlier frame in this frame's ego frame, velocities rotated, with their age last."""
    placed = np.concatenate([rows, np.full((len(rows), 1), age_s, np.float32)], axis=1)
    if then is not now:
        ego_from_then = now.global_from_ego.inverse() @ then.global_from_ego
        placed[:, :3] = ego_from_then @ rows[:, :3].astype(np.float64)
        if rows.shape[1] == 6:
            turned = np.pad(rows[:, 4:].astype(np.float64), ((0, 0), (0, 1))) @ ego_from_then.rotation().T
            placed[:, 4:6] = turned[:, :2]
    return placed


def _points(rows: NDArray[np.float32], mirrors: GridMirrors, turns_velocities: bool = False) -> Points:
    signs = mirrors.grid_from_ego().diagonal().astype(np.float32)
    mirrored = rows.copy()
    mirrored[:, :3] *= signs[:3]
    if turns_velocities:
        mirrored[:, 4:6] *= signs[:2]
    return Points(torch.from_numpy(mirrored), torch.zeros(len(mirrored), dtype=torch.int64))


def _stacked(matrices: Sequence[NDArray[np.float64]]) -> torch.Tensor:
    return torch.from_numpy(np.stack(matrices)).float()[None]


# Targets of depth networks: the LiDAR's depth at pixels. Depth is along z of the optical frame, metres; the nearest of
# several points at a pixel counts.


def depth_picture(
    points_ego: NDArray[np.float32],
    image_from_camera: NDArray[np.floating[Any]],
    camera_from_ego: NDArray[np.floating[Any]],
    size_px: tuple[int, int],
) -> NDArray[np.float32]:
    """Return the depth (H, W) along z in metres of the nearest point (N, 3) at each pixel, 0 without a point."""
    points = points_ego.astype(np.float64) @ camera_from_ego[:3, :3].T + camera_from_ego[:3, 3]
    points = points[points[:, 2] > 0.1]
    rays = points @ image_from_camera.T
    pixels = np.rint(rays[:, :2] / rays[:, 2:])
    is_inside = ((pixels >= 0) & (pixels < (size_px[1], size_px[0]))).all(axis=1)
    columns, rows = pixels[is_inside].astype(np.int64).T
    depth_m = np.full(size_px, np.inf, np.float32)
    np.minimum.at(depth_m, (rows, columns), points[is_inside, 2].astype(np.float32))
    return np.where(np.isfinite(depth_m), depth_m, np.float32(0))
