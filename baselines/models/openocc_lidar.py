"""LiDAR branch of OpenOccupancy: sweeps to a dense volume on the coarse lattice.

Source: `occ_plugin/occupancy/detectors/occnet.py`, `OccNet.extract_pts_feat`, with the configs' 0.1 m voxels.
"""

import torch
from torch import Tensor, nn

from baselines.batch import POINT_FEATURES, Batch
from baselines.lattice import VoxelLattice
from baselines.layers.sparse_encoder import SparseEncoder
from baselines.layers.sparse_voxels import means_of_points
from baselines.models.openocc_config import OpenOccConfig

COLUMNS = tuple(POINT_FEATURES.index(name) for name in ("x", "y", "z", "age_s"))


class LidarVoxelEncoder(nn.Module):
    """Means of x, y, z and age in small voxels, then sparse convolutions down to the coarse lattice."""

    def __init__(self, config: OpenOccConfig) -> None:
        super().__init__()
        self.lattice = lattice_of_points(config)
        ratio = self.lattice.shape[0] // config.coarse_lattice.shape[0]
        self.encoder = SparseEncoder(len(COLUMNS), config.sparse_channels, config.volume_channels, ratio)

    def forward(self, batch: Batch) -> Tensor:
        """(B, volume_channels, x, y, z). Raises `ValueError` without LiDAR."""
        if batch.lidar is None:
            raise ValueError("this batch has no LiDAR")
        with torch.autocast(batch.device.type, enabled=False):
            features = batch.lidar.features[:, COLUMNS].float()
            voxels = means_of_points(batch.lidar, features, self.lattice, len(batch))
        volume: Tensor = self.encoder(voxels)
        return volume


def lattice_of_points(config: OpenOccConfig) -> VoxelLattice:
    """The same volume in voxels of `lidar_voxel_m`. Raises `ValueError` where a coarse cell holds no whole number."""
    coarse, size = config.coarse_lattice, config.lidar_voxel_m
    ratios = [round(length / size) for length in coarse.voxel_m]
    if any(abs(length - size * n) > 1e-6 * length for length, n in zip(coarse.voxel_m, ratios, strict=True)):
        raise ValueError(f"coarse cells of {coarse.voxel_m} m are not whole numbers of voxels of {size} m")
    x, y, z = (cells * n for cells, n in zip(coarse.shape, ratios, strict=True))
    return VoxelLattice(coarse.min_m, (size, size, size), (x, y, z))
