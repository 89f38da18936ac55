"""ColumnNet: our own traversability network in 2.5 dimensions, light enough for a robot.

Off-road scenes are mostly a height map with objects on it. Points become columns that follow the terrain
(`layers/terrain_columns.py`); a 2D U-Net reads them, and each column predicts the classes of all its heights at once,
at full resolution. Only these steps depend on the number of points; `TraversabilityNet` is plain, of static shapes.

A second output is the uncertainty: the logarithm of a temperature of each voxel, learned from the cross entropy alone
and without changing the classes. Source: Ding et al., Local Temperature Scaling for Probability Calibration, ICCV 2021.
"""

from math import log
from typing import NamedTuple, cast

import torch
from torch import Tensor, nn

from baselines.batch import IGNORED, POINT_FEATURES, Batch, Points
from baselines.layers.column_cameras import ColumnCameras, ColumnUNet
from baselines.layers.sensor_fusion import unit2d
from baselines.layers.terrain_columns import (
    EVIDENCE,
    RADAR_STATISTICS,
    STATISTICS,
    ColumnAlignment,
    ColumnHits,
    TerrainColumns,
    column_hits,
    evidence_of,
    radar_maps,
    reference_of,
    statistics_of,
    surface_of,
)
from baselines.losses.voxels import FREE, cross_entropy, lovasz_softmax, semantic_scale
from baselines.models.column_net_config import ColumnNetConfig
from baselines.models.occfusion import points_of
from baselines.models.occupancy_model import CLASSES, OccupancyModel, likeliest

EASY = 0.02  # free voxels with a lower occupied probability are left out of sorts and sums, with little effect
PRIOR = 0.01  # initial probability of an occupied voxel (Lin et al., ICCV 2017, section 4.1)
WARMEST = 3.0  # upper limit of |log temperature|


class ColumnOutputs(NamedTuple):
    """`logits` (B, 4, X, Y, Z), and `log_temperature` (B, 1, X, Y, Z), the logarithm of their divisor for
    probabilities.
    """

    logits: Tensor
    log_temperature: Tensor

    def calibrated(self) -> Tensor:
        """Return logits (B, 4, X, Y, Z) float32 whose softmax is a probability; the largest is the same."""
        return self.logits.float() / self.log_temperature.float().exp()

    def uncertainty(self) -> Tensor:
        """Return the entropy (B, X, Y, Z) of each voxel's probabilities over the entropy of four equal ones: 0 … 1."""
        logarithms = self.calibrated().log_softmax(dim=1)
        return -(logarithms.exp() * logarithms).sum(dim=1) / log(CLASSES)


class ColumnGeometry(NamedTuple):
    """Unlearned features of columns.

    `maps` (B, C, X, Y), `base` (B, X, Y) int64 of their aligned heights, and `surface_m` (B, 2, X, Y), grid frame, the
    heights for camera lookups.
    """

    maps: Tensor
    base: Tensor
    surface_m: Tensor


class TraversabilityNet(nn.Module):
    """Maps of aligned columns (B, C, X, Y) and their bases (B, X, Y) to classes and temperatures of the lattice.

    The first 3 K maps are the hits at each of the `heights`: a column's output layer sees its own maps directly, beside
    the U-Net's features of its surroundings.
    """

    def __init__(self, config: ColumnNetConfig, channels: int) -> None:
        super().__init__()
        self.heights, self.lattice_heights = config.heights, config.lattice.shape[2]
        width = config.widths[0]
        self.stem = nn.Sequential(nn.BatchNorm2d(channels), *unit2d(channels, width, 1))
        self.unet = ColumnUNet(config.widths, config.depths, config.head_channels)
        self.mix = unit2d(width + EVIDENCE * config.heights, config.mixed_channels, 1)
        self.classify = nn.Conv2d(config.mixed_channels + config.heights, CLASSES * config.heights, 1)
        self.warm = nn.Conv2d(config.mixed_channels + config.heights, config.heights, 1)
        nn.init.zeros_(self.warm.weight)
        nn.init.normal_(self.classify.weight, std=0.01)
        nn.init.constant_(cast("Tensor", self.classify.bias)[: config.heights], log(3 * (1 - PRIOR) / PRIOR))

    def forward(self, maps: Tensor, base: Tensor) -> tuple[Tensor, Tensor]:
        mixed = self.mix(torch.cat([self.unet(self.stem(maps)), maps[:, : EVIDENCE * self.heights]], dim=1))
        features = torch.cat([mixed, maps[:, : self.heights]], dim=1)
        log_temperature = WARMEST * torch.tanh(self.warm(features.detach()))
        aligned = torch.cat([self.classify(features), log_temperature], dim=1)
        voxels = self._voxels(aligned.reshape(len(aligned), CLASSES + 1, self.heights, *aligned.shape[2:]), base)
        return voxels[:, :CLASSES], voxels[:, CLASSES:]

    def _voxels(self, aligned: Tensor, base: Tensor) -> Tensor:
        """Return (B, C, K, X, Y) of aligned heights as (B, C, X, Y, Z); the lowest and highest values continue beyond
        them.
        """
        z = torch.arange(self.lattice_heights, device=base.device)[None, :, None, None]
        height = (z - base[:, None]).clamp(0, self.heights - 1)
        index = height[:, None].expand(-1, aligned.shape[1], -1, -1, -1)
        return aligned.gather(2, index).permute(0, 1, 3, 4, 2)


class ColumnNet(OccupancyModel[ColumnOutputs]):
    """Columns of a batch, and `TraversabilityNet` on them."""

    def __init__(self, config: ColumnNetConfig) -> None:
        super().__init__()
        self.config, self.lattice, self.modality = config, config.lattice, config.modality
        self.alignment = ColumnAlignment(config.lattice, config.heights, config.heights_below)
        parts = config.modality.split("+")
        self.has_lidar, self.has_radar = "L" in parts, "R" in parts
        self.cameras = ColumnCameras(config.image_channels, config.image_pool, config.lattice) if "C" in parts else None
        channels = self.geometry_channels() + (self.cameras is not None) * 2 * config.image_channels
        self.net = TraversabilityNet(config, channels)

    def forward(self, batch: Batch) -> ColumnOutputs:
        logits, log_temperature = self.net(*self.columns(batch))
        return ColumnOutputs(logits, log_temperature)

    def columns(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """Return the inputs of `TraversabilityNet`: maps (B, C, X, Y) and bases (B, X, Y)."""
        maps, base, surface_m = self.geometry(batch)
        if self.cameras is not None:
            maps = torch.cat([maps, self._camera_maps(self.cameras, batch, surface_m)], dim=1)
        return maps, base

    def geometry_channels(self) -> int:
        """Return the channels of the maps of `geometry`."""
        return EVIDENCE * self.config.heights + STATISTICS + self.has_radar * RADAR_STATISTICS

    def geometry(self, batch: Batch) -> ColumnGeometry:
        """Return all unlearned inputs."""
        with torch.autocast(batch.device.type, enabled=False):
            hits, terrain = self._columns_hit(batch)
            evidence = evidence_of(hits, terrain, self.alignment, self.config.newest_s)
            maps = [evidence, statistics_of(hits, terrain, self.lattice)]
            if self.has_radar:
                maps.append(radar_maps(column_hits(points_of(batch, "radar"), self.lattice), terrain))
            surface_m = surface_of(hits, terrain, self.config.unhit_top_m)
            return ColumnGeometry(torch.cat(maps, dim=1), terrain.base, surface_m)

    def losses(self, outputs: ColumnOutputs, batch: Batch) -> dict[str, Tensor]:
        if batch.labels is None:
            raise ValueError("this batch has no labels")
        with torch.autocast(batch.device.type, enabled=False):
            logits = outputs.logits.float()
            cooled = ColumnOutputs(logits.detach(), outputs.log_temperature).calibrated()
            weights = logits.new_tensor(self.config.class_weights)
            hard = hard_voxels(logits, batch.labels)
            return {
                "cross_entropy": cross_entropy(logits, batch.labels, weights),
                "lovasz": self.config.lovasz_weight * lovasz_softmax(*hard),
                "semantic": self.config.semantic_weight * semantic_scale(*hard),
                "temperature": self.config.temperature_weight * cross_entropy(cooled, batch.labels),
            }

    def logits(self, outputs: ColumnOutputs, batch: Batch) -> Tensor:
        return outputs.calibrated()

    def classes(self, outputs: ColumnOutputs, batch: Batch) -> Tensor:
        return likeliest(outputs.logits)  # temperatures do not change which logit is the largest

    def _columns_hit(self, batch: Batch) -> tuple[ColumnHits, TerrainColumns]:
        """Return points of the LiDAR and the terrain under them; without a LiDAR the radar's, or none, over a plane."""
        if self.has_lidar:
            hits = column_hits(points_of(batch, "lidar"), self.lattice)
            return hits, self.alignment.terrain(reference_of(hits, len(batch), self.lattice))
        flat = self.alignment.terrain(batch.grid_from_ego.new_zeros(len(batch), 1, *self.lattice.shape[:2]))
        if self.has_radar:
            return column_hits(points_of(batch, "radar"), self.lattice), flat
        none = Points(flat.reference_m.new_zeros(0, len(POINT_FEATURES)), flat.base.new_zeros(0))
        return column_hits(none, self.lattice), flat

    def _camera_maps(self, cameras: ColumnCameras, batch: Batch, surface_m: Tensor) -> Tensor:
        if batch.cameras is None:
            raise ValueError("this model requires cameras, but this batch has none")
        maps: Tensor = cameras(batch.cameras, batch.grid_from_camera(), surface_m)
        return maps


def hard_voxels(logits: Tensor, labels: Tensor) -> tuple[Tensor, Tensor]:
    """Return logits (M, C) and labels (M,) of the counted voxels that are occupied, or not surely predicted free."""
    is_doubtful = logits.detach()[:, FREE + 1 :].amax(dim=1) - logits.detach()[:, FREE] > log(EASY / (CLASSES - 1))
    is_hard = (labels != IGNORED) & ((labels != FREE) | is_doubtful)
    return logits.movedim(1, -1)[is_hard], labels[is_hard]
