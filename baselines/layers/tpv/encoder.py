"""Encoder of TPVFormer: learned queries of three planes, refined by attention to each other and to the images.

Source: Huang et al., CVPR 2023, section 3.3; wzzheng/TPVFormer tpvformer04/tpv_head.py, modules/tpvformer_layer.py and
config/tpv04_occupancy.py; the position encoding is mmdet's learned one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, cast

import torch
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from baselines.lattice import VoxelLattice
from baselines.layers.tpv.attention import CrossViewHybridAttention, ImageCrossAttention, PlaneAttentionConfig
from baselines.layers.tpv.camera_sight import CameraRig, ColumnSights, column_sights

# Three planes through a volume, and the points of it that each cell of a plane covers. The planes are, in this order,
# top (x, y), front (y, z) and side (x, z), by the axes of their rows and columns. A plane's cells run over its rows,
# then columns. A cell covers the column of the volume across its plane, and anchors are points spread along that
# column. Source: Huang et al., TPVFormer, CVPR 2023, section 3.2; wzzheng/TPVFormer tpvformer04/modules/encoder.py,
# whose planes hw, zh and wz these are.


AXES = ((0, 1), (1, 2), (0, 2))  # rows and columns of the top, front and side plane
MARGIN_M = 0.5  # between the outermost anchors and the volume's faces (official)


class TriPlanes(NamedTuple):
    """A map (B, channels, rows, columns) of each plane."""

    top: Tensor
    front: Tensor
    side: Tensor


def plane_sizes(lattice: VoxelLattice) -> tuple[tuple[int, int], ...]:
    """Return rows and columns of the three planes."""
    return tuple((lattice.shape[rows], lattice.shape[columns]) for rows, columns in AXES)


def anchor_points_m(lattice: VoxelLattice, plane: int, anchors: int) -> Tensor:
    """Return the points (rows · columns, anchors, 3) in metres of the cells of a plane."""
    across = ({0, 1, 2} - set(AXES[plane])).pop()
    axes = [
        low + size * (torch.arange(n, dtype=torch.float32) + 0.5)
        for low, size, n in zip(lattice.min_m, lattice.voxel_m, lattice.shape, strict=True)
    ]
    low, high = lattice.min_m[across], lattice.max_m[across]
    margin = min(MARGIN_M, (high - low) / 2)
    axes[across] = torch.linspace(low + margin, high - margin, anchors)
    return torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1).movedim(across, 2).flatten(0, 1)


def as_planes(cells: Tensor, lattice: VoxelLattice) -> TriPlanes:
    """Return cells (B, of the three planes one after another, channels) as maps."""
    sizes = plane_sizes(lattice)
    parts = torch.split(cells, [rows * columns for rows, columns in sizes], dim=1)
    top, front, side = (torch.unflatten(part.transpose(1, 2), 2, size) for part, size in zip(parts, sizes, strict=True))
    return TriPlanes(top, front, side)


@dataclass(frozen=True)
class TPVEncoderConfig:
    """`lattice` is of the planes, so coarser than the model's; `cameras` is the number per frame."""

    lattice: VoxelLattice
    attention: PlaneAttentionConfig
    layers: int = 3
    cameras: int = 6
    feedforward_channels: int = 512
    checkpoint_gradients: bool = False


class TPVEncoderLayer(nn.Module):
    """Attention of the top plane to itself, of all planes to the images, a multilayer perceptron; each added, then
    normalised.
    """

    def __init__(self, config: TPVEncoderConfig) -> None:
        super().__init__()
        channels, dropout = config.attention.channels, config.attention.dropout
        self.size = plane_sizes(config.lattice)[0]
        self.hybrid_attention = CrossViewHybridAttention(config.attention)
        self.image_attention = ImageCrossAttention(config.attention)
        self.perceptron = nn.Sequential(
            nn.Linear(channels, config.feedforward_channels),
            nn.ReLU(),
            nn.Dropout(dropout),
            nn.Linear(config.feedforward_channels, channels),
            nn.Dropout(dropout),
        )
        for module in self.perceptron:
            if isinstance(module, nn.Linear):
                nn.init.xavier_uniform_(module.weight)
        self.norms = nn.ModuleList([nn.LayerNorm(channels) for _ in range(3)])

    def forward(
        self, cells: Tensor, positions: Tensor, features: Sequence[Tensor], sights: Sequence[ColumnSights]
    ) -> Tensor:
        """Return cells from cells (B, of the three planes one after another, C); `positions` are of the top plane's
        cells.
        """
        top, others = cells.tensor_split([len(positions)], dim=1)
        cells = self.norms[0](torch.cat([self.hybrid_attention(top, positions, self.size), others], dim=1))
        cells = self.norms[1](self.image_attention(cells, features, sights))
        return cast("Tensor", self.norms[2](cells + self.perceptron(cells)))


class LearnedPositions(nn.Module):
    """Positions (rows · columns, C) of a map's cells: half of the channels encode the column, half the row."""

    def __init__(self, size: tuple[int, int], channels: int) -> None:
        super().__init__()
        self.rows = nn.Parameter(torch.empty(size[0], channels // 2))
        self.columns = nn.Parameter(torch.empty(size[1], channels - channels // 2))
        nn.init.xavier_uniform_(self.rows)
        nn.init.xavier_uniform_(self.columns)

    def forward(self) -> Tensor:
        columns = self.columns.expand(len(self.rows), -1, -1)
        rows = self.rows[:, None].expand(-1, len(self.columns), -1)
        return torch.cat([columns, rows], dim=-1).flatten(0, 1)


class TPVEncoder(nn.Module):
    """Features of the images, one (B, N, C, rows, columns) per level, to three planes of `config.lattice`.

    Raises `ValueError` if N is not `config.cameras`, since each camera has its own embedding.
    """

    def __init__(self, config: TPVEncoderConfig) -> None:
        super().__init__()
        self.config = config
        channels = config.attention.channels
        sizes = plane_sizes(config.lattice)
        self.queries = nn.ParameterList([torch.empty(rows * columns, channels) for rows, columns in sizes])
        self.positions = LearnedPositions(sizes[0], channels)
        self.camera_embeddings = nn.Parameter(torch.randn(config.cameras, channels))
        self.level_embeddings = nn.Parameter(torch.randn(config.attention.levels, channels))
        self.layers = nn.ModuleList([TPVEncoderLayer(config) for _ in range(config.layers)])
        for weight in self.queries:
            nn.init.xavier_uniform_(weight)

    def forward(self, features: Sequence[Tensor], rig: CameraRig, size_px: tuple[int, int]) -> TriPlanes:
        """Return the planes; `size_px`: rows and columns of the padded images."""
        batch, cameras = features[0].shape[:2]
        if cameras != self.config.cameras:
            raise ValueError(f"the batch has {cameras} cameras, but this model requires {self.config.cameras}")
        of_cameras = self.camera_embeddings[:, :, None, None]
        embedded = [
            level + of_cameras + of_level[:, None, None]
            for level, of_level in zip(features, self.level_embeddings, strict=True)
        ]
        sights = self._sights(rig, size_px)
        cells = torch.cat(list(self.queries)).expand(batch, -1, -1)
        for layer in self.layers:
            cells = self._through(layer, cells, self.positions(), embedded, sights)
        return as_planes(cells, self.config.lattice)

    def _sights(self, rig: CameraRig, size_px: tuple[int, int]) -> list[ColumnSights]:
        points = [
            anchor_points_m(self.config.lattice, plane, n) for plane, n in enumerate(self.config.attention.anchors)
        ]
        return [column_sights(of_plane.to(rig.pixels_from_grid.device), rig, size_px) for of_plane in points]

    def _through(self, layer: nn.Module, *inputs: object) -> Tensor:
        if self.config.checkpoint_gradients and self.training:
            return cast("Tensor", checkpoint(layer, *inputs, use_reentrant=False))
        return cast("Tensor", layer(*inputs))
