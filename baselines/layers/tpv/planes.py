"""Three planes through a volume, and the points of it that each cell of a plane stands for.

**Conventions.** The planes are, in this order, top (x, y), front (y, z) and side (x, z): by the axes of their rows and
columns; a plane's cells run over its rows, then columns. A cell stands for the column of the volume across its
plane, and anchors are points spread along that column. Source: Huang et al., TPVFormer, CVPR 2023, section 3.2;
wzzheng/TPVFormer tpvformer04/modules/encoder.py, whose planes hw, zh and wz these are.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from baselines.lattice import VoxelLattice

AXES = ((0, 1), (1, 2), (0, 2))  # rows and columns of the top, front and side plane
MARGIN_M = 0.5  # between the outermost anchors and the volume's faces, as official


class TriPlanes(NamedTuple):
    """A map (B, channels, rows, columns) of each plane."""

    top: Tensor
    front: Tensor
    side: Tensor


def plane_sizes(lattice: VoxelLattice) -> tuple[tuple[int, int], ...]:
    """Rows and columns of the three."""
    return tuple((lattice.shape[rows], lattice.shape[columns]) for rows, columns in AXES)


def anchor_points_m(lattice: VoxelLattice, plane: int, anchors: int) -> Tensor:
    """Points (rows · columns, anchors, 3) in metres that the cells of a plane stand for."""
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
    """Cells (B, of the three planes one after another, channels) as maps."""
    sizes = plane_sizes(lattice)
    parts = torch.split(cells, [rows * columns for rows, columns in sizes], dim=1)
    top, front, side = (torch.unflatten(part.transpose(1, 2), 2, size) for part, size in zip(parts, sizes, strict=True))
    return TriPlanes(top, front, side)
