"""A frame of ground, a track and boxes that LiDAR sees, and OpenOccupancy's rows small enough for it."""

from dataclasses import replace

import torch
from torch import Tensor

from baselines.batch import IGNORED, Batch, Points
from baselines.lattice import VoxelLattice
from baselines.models.openocc_config import Modality, OpenOccConfig

LATTICE = VoxelLattice((-3.2, -3.2, -1.6), (0.2, 0.2, 0.2), (32, 32, 16))


def small_row(modality: Modality = "L", *, is_cascade: bool = False) -> OpenOccConfig:
    """A row of a few ten thousand parameters on 32 × 32 × 16 voxels."""
    return OpenOccConfig(
        modality=modality,
        is_cascade=is_cascade,
        lattice=LATTICE,
        volume_channels=16,
        sparse_channels=8,
        image_shape=(64, 96),
        resnet_width=8,
        neck_channels=(16, 16, 16, 16),
        depth_range_m=(0.5, 6.5),
        residual_channels=(16, 16, 32, 32),
        residual_blocks=(1, 1, 1, 1),
        pyramid_channels=32,
        fine_channels=16,
        refined_cells=600,
        class_counts=(14_000, 200, 900, 600),
    )


def labels_of_a_world(seed: int) -> Tensor:
    """(32, 32, 16): ground of class P with a track of T, boxes of N on it, a corner that nobody observed."""
    random = torch.Generator().manual_seed(seed)
    labels = torch.zeros(LATTICE.shape, dtype=torch.uint8)
    labels[:, :, 5] = 2
    track = int(torch.randint(8, 20, (1,), generator=random))
    labels[:, track : track + 4, 5] = 1
    for x, y, length, height in torch.randint(3, 8, (4, 4), generator=random).tolist():
        labels[4 * x - 8 : 4 * x - 8 + length, 4 * y - 10 : 4 * y - 10 + length, 6 : 6 + height] = 3
    labels[-4:, -4:] = IGNORED
    return labels


def sweep_of(labels: Tensor, seed: int, per_voxel: int = 4) -> Tensor:
    """Points (P, 5) scattered over the voxels that are occupied."""
    random = torch.Generator().manual_seed(seed)
    cells = ((labels > 0) & (labels != IGNORED)).nonzero().repeat(per_voxel, 1)
    low, size = torch.tensor(LATTICE.min_m), torch.tensor(LATTICE.voxel_m)
    place = low + (cells + torch.rand(cells.shape, generator=random)) * size
    rest = torch.rand(len(cells), 2, generator=random)
    return torch.cat([place, rest], dim=1)


def lidar_batch(frames: int = 2) -> Batch:
    labels = [labels_of_a_world(seed) for seed in range(frames)]
    sweeps = [sweep_of(world, seed) for seed, world in enumerate(labels)]
    frame = torch.cat([torch.full((len(sweep),), i) for i, sweep in enumerate(sweeps)])
    return Batch(
        tokens=tuple(f"frame-{i}" for i in range(frames)),
        grid_from_ego=torch.eye(4).expand(frames, 4, 4),
        lidar=Points(torch.cat(sweeps), frame),
        labels=torch.stack(labels),
    )


def without_labels(batch: Batch) -> Batch:
    return replace(batch, labels=None)
