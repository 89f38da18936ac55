"""The configurations of OpenOccupancy's six rows: C, L and M-OpenOcc, and with the cascade C, L and M-CoNet.

Source: Wang et al., OpenOccupancy, ICCV 2023; the official `projects/configs/{baselines,Cascade-Occupancy-Network}`.
"""

from dataclasses import dataclass, field
from typing import Literal

from baselines.lattice import VoxelLattice

Modality = Literal["C", "L", "C+L"]
FourInts = tuple[int, int, int, int]

# Voxels of free, T, P, N in ten frames of a simulated world; training sets its own.
TEN_FRAMES: FourInts = (20_510_000, 2_900, 120_000, 336_000)


@dataclass(frozen=True)
class OpenOccConfig:
    """One row, on a lattice. Defaults are L-OpenOcc's; `official_row` returns each of the six.

    `coarse_ratio` is 4 officially, for 512 × 512 × 40 voxels. On this grid it gives 64 × 64 × 8 cells, from which even
    true labels recover less than half of the occupied voxels. The default 2 gives 128 × 128 × 16, about as many as
    officially.

    `supervises_voxels` compares coarse logits, interpolated, with the labels themselves; officially, and by default,
    with coarse labels. Only then can a row without the cascade learn surfaces thinner than a cell.
    """

    architecture: Literal["openocc"] = "openocc"
    modality: Modality = "L"
    is_cascade: bool = False
    lattice: VoxelLattice = field(default_factory=VoxelLattice)
    coarse_ratio: int = 2
    volume_channels: int = 80  # each modality's coarse volume

    lidar_voxel_m: float = 0.1
    sparse_channels: int = 16  # at the first stage of the sparse encoder

    image_shape: tuple[int, int] = (896, 1600)  # height, width
    resnet_depth: Literal[14, 26, 50, 101] = 50
    resnet_width: int = 64
    frozen_stages: int = -1  # the ResNet's; officially 0 (its stem), which requires pretrained weights
    neck_channels: FourInts = (128, 128, 128, 128)
    depth_range_m: tuple[float, float] = (2.0, 58.0)
    depth_step_m: float = 0.5
    depth_dropout: float = 0.5

    residual_channels: FourInts = (80, 160, 320, 640)
    residual_blocks: FourInts = (2, 2, 2, 2)
    pyramid_channels: int = 256
    fine_channels: int = 64  # the cascade's; a multiple of 4
    refined_cells: int = 15_000  # limit per frame of occupied coarse cells in training; all when predicting

    class_counts: FourInts = TEN_FRAMES  # voxels of free, T, P, N: the weight of a class is 1 / log of its count
    supervises_voxels: bool = False
    normalises_losses: bool = True  # each by its own value, as officially: only directions of gradients are weighted
    depth_loss_weight: float = 3.0  # without effect if losses are normalised, as officially
    checkpoint_gradients: bool = False

    @property
    def has_cameras(self) -> bool:
        return "C" in self.modality

    @property
    def has_lidar(self) -> bool:
        return "L" in self.modality

    @property
    def coarse_lattice(self) -> VoxelLattice:
        return self.lattice.coarser(self.coarse_ratio)

    @property
    def image_channels(self) -> int:
        """The channels of the image neck's features, at a sixteenth of the image's size."""
        return sum(self.neck_channels)


def official_row(modality: Modality, is_cascade: bool) -> OpenOccConfig:
    """Return a row's official sizes: only C-OpenOcc has a narrower 3D network, only M-CoNet refines fewer cells."""
    is_narrow = modality == "C" and not is_cascade
    return OpenOccConfig(
        modality=modality,
        is_cascade=is_cascade,
        residual_channels=(64, 128, 256, 512) if is_narrow else (80, 160, 320, 640),
        refined_cells=10_000 if modality == "C+L" and is_cascade else 15_000,
    )
