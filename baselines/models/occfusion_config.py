"""Sizes of OccFusion; the defaults are the published ones on the benchmark's grid."""

from dataclasses import dataclass, field
from typing import Literal

from baselines.lattice import VoxelLattice


@dataclass(frozen=True)
class OccFusionConfig:
    """`level_channels` are of the lattice and of the three lattices 2, 4 and 8 times as coarse.

    The three coarser ones take the image's maps of strides 8, 16 and 32. `point_widths` are the voxel encoder's. The
    backbone's stem and first stage are frozen and its norms keep their statistics, as published; this requires
    pretrained weights. Without them `frozen_stages` is -1 and `norm_eval` false.
    """

    architecture: Literal["occfusion"] = "occfusion"
    modality: Literal["C", "C+R", "C+L", "C+L+R"] = "C+R"
    lattice: VoxelLattice = field(default_factory=VoxelLattice)
    resnet_depth: Literal[14, 26, 50, 101] = 101
    resnet_width: int = 64
    deformable_stages: tuple[bool, bool, bool, bool] = (False, False, True, True)
    frozen_stages: int = 1
    norm_eval: bool = True
    pyramid_channels: int = 512
    level_channels: tuple[int, int, int, int] = (32, 64, 128, 256)
    point_widths: tuple[int, ...] = (16, 32)
    head_channels: int = 32  # per attention head
    atrous_rates: tuple[int, ...] = (6, 12, 18)
    level_weights: tuple[float, float, float, float] = (1.0, 0.5, 0.25, 0.125)
    focal_gamma: float = 2.0
    focal_alpha: float = 0.25
    checkpoint_gradients: bool = False
