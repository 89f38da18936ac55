"""Sizes of ColumnNet; the defaults are for the benchmark's grid."""

from dataclasses import dataclass, field
from typing import Literal

from baselines.lattice import VoxelLattice


@dataclass(frozen=True)
class ColumnNetConfig:
    """`heights` of a column follow the terrain, `heights_below` of them under it; `widths` are a U-Net's, finest first.

    X and Y of the lattice are multiples of 4 and of 2 ** (scales − 1).
    """

    architecture: Literal["column_net"] = "column_net"
    modality: Literal["C", "L", "R", "C+L", "C+R", "L+R", "C+L+R"] = "C+L+R"
    lattice: VoxelLattice = field(default_factory=VoxelLattice)
    heights: int = 48  # with `heights_below` they cover 98 % of occupied voxels in simulated hills
    heights_below: int = 16
    newest_s: float = 0.05  # points up to this age belong to the frame's own sweep
    widths: tuple[int, ...] = (48, 64, 96, 128)
    depths: tuple[int, ...] = (1, 2, 2, 3)
    head_channels: int = 16  # per attention head
    mixed_channels: int = 96  # a column's surroundings and its own hits together, for its heights
    image_channels: int = 16
    image_pool: int = 2
    unhit_top_m: float = 0.8  # above the ground: assumed top of a column without points, for camera lookups
    class_weights: tuple[float, float, float, float] = (1.0, 4.0, 2.0, 2.0)  # free, T, P, N
    lovasz_weight: float = 1.0
    semantic_weight: float = 1.0
    temperature_weight: float = 0.1
