"""What the six rows of OpenOccupancy are made of: C, L and M-OpenOcc, and with the cascade C, L and M-CoNet.

Source: Wang et al., OpenOccupancy, ICCV 2023; the official `projects/configs/{baselines,Cascade-Occupancy-Network}`.
"""

from dataclasses import dataclass, field
from typing import Literal

from baselines.lattice import VoxelLattice

Modality = Literal["C", "L", "C+L"]
FourInts = tuple[int, int, int, int]

# Voxels of free, T, P, N in ten frames of a simulated world; a training states its own.
TEN_FRAMES: FourInts = (20_510_000, 2_900, 120_000, 336_000)


@dataclass(frozen=True)
class OpenOccConfig:
    """One row, on a lattice. Defaults are L-OpenOcc's; `official_row` gives each of the six.

    `coarse_ratio` is 4 officially, of 512 × 512 × 40 voxels. On this grid that leaves 64 × 64 × 8 cells, from which not
    even true labels bring back half of what is occupied; 2 leaves 128 × 128 × 16, about as many as officially.

    `supervises_voxels` compares coarse logits, interpolated, with the labels themselves; officially, and by default,
    with labels made coarse. A row without the cascade can only then learn surfaces thinner than a cell.
    """

    architecture: Literal["openocc"] = "openocc"
    modality: Modality = "L"
    is_cascade: bool = False
    lattice: VoxelLattice = field(default_factory=VoxelLattice)
    coarse_ratio: int = 2
    volume_channels: int = 80  # of the coarse volume that each modality gives

    lidar_voxel_m: float = 0.1
    sparse_channels: int = 16  # at the first stage of the sparse encoder

    image_shape: tuple[int, int] = (896, 1600)  # height, width
    resnet_depth: Literal[14, 26, 50, 101] = 50
    resnet_width: int = 64
    frozen_stages: int = -1  # of the ResNet; officially 0, its stem, which then needs pretrained weights
    neck_channels: FourInts = (128, 128, 128, 128)
    depth_range_m: tuple[float, float] = (2.0, 58.0)
    depth_step_m: float = 0.5
    depth_dropout: float = 0.5

    residual_channels: FourInts = (80, 160, 320, 640)
    residual_blocks: FourInts = (2, 2, 2, 2)
    pyramid_channels: int = 256
    fine_channels: int = 64  # of the cascade; a multiple of 4
    refined_cells: int = 15_000  # at most, of a frame's occupied coarse cells while training; all when predicting

    class_counts: FourInts = TEN_FRAMES  # voxels of free, T, P, N: a class weighs 1 / log of its count
    supervises_voxels: bool = False
    normalises_losses: bool = True  # each by its own value, as officially: only directions of gradients are weighed
    depth_loss_weight: float = 3.0  # of no effect where losses are normalised, as officially
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
        """Of the features that the image neck gives, at a sixteenth of the image's size."""
        return sum(self.neck_channels)


def official_row(modality: Modality, is_cascade: bool) -> OpenOccConfig:
    """The official sizes of a row: C-OpenOcc alone has a narrower 3D network, M-CoNet alone refines fewer cells."""
    is_narrow = modality == "C" and not is_cascade
    return OpenOccConfig(
        modality=modality,
        is_cascade=is_cascade,
        residual_channels=(64, 128, 256, 512) if is_narrow else (80, 160, 320, 640),
        refined_cells=10_000 if modality == "C+L" and is_cascade else 15_000,
    )
