"""Points as columns that follow the terrain: a map of the ground below them, and the hits above it.

**Conventions.** The *reference* of a column is a smooth estimate of the ground's height from the lowest points near it.
An *aligned* height k of K is k + ½ voxels above the column's *base*. The base is a voxel index of the lattice's z axis
(below 0 or beyond the lattice if the terrain is). So neighbouring columns of one slope are similar, whatever their
heights. Maps are (B, channels, X, Y). All in float32 outside autocast; nothing here is learned.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from baselines.batch import Points
from baselines.lattice import VoxelLattice

BLOCK = 4  # side of a block, in columns, whose lowest point counts as ground
FULL_VOXEL = 3.0  # log(1 + points) of a voxel that counts as well hit


class TerrainColumns(NamedTuple):
    """`reference_m` (B, 1, X, Y), grid frame; `base` (B, X, Y) int64, the voxel index of aligned height 0."""

    reference_m: Tensor
    base: Tensor


@dataclass(frozen=True)
class ColumnAlignment:
    """Aligned heights: `heights` in all, `below` of them under the reference."""

    lattice: VoxelLattice
    heights: int
    below: int

    def terrain(self, reference_m: Tensor) -> TerrainColumns:
        low, size = self.lattice.min_m[2], self.lattice.voxel_m[2]
        return TerrainColumns(reference_m, torch.floor((reference_m[:, 0] - low) / size).long() - self.below)


class ColumnHits(NamedTuple):
    """P points in the lattice: `features` (P, F), `voxel` (P, 3), `frame` (P,), `column` (P,) of B · X · Y."""

    features: Tensor
    voxel: Tensor
    frame: Tensor
    column: Tensor


def column_hits(points: Points, lattice: VoxelLattice) -> ColumnHits:
    index, is_inside = lattice.indices_of(points.features[:, :3])
    inside = is_inside.nonzero()[:, 0]
    index, frame = index[inside], points.frame[inside]
    column = (frame * lattice.shape[0] + index[:, 0]) * lattice.shape[1] + index[:, 1]
    return ColumnHits(points.features[inside], index, frame, column)


def reference_of(hits: ColumnHits, frames: int, lattice: VoxelLattice) -> Tensor:
    """Return heights (B, 1, X, Y) in metres: the lowest point of each block of columns, interpolated and smoothed.

    0 for a frame without points. Raises `ValueError` if `BLOCK` does not divide the lattice.
    """
    x, y, _ = lattice.shape
    if x % BLOCK or y % BLOCK:
        raise ValueError(f"a lattice of {x} × {y} columns has no blocks of {BLOCK} × {BLOCK}")
    lowest = hits.features.new_full((frames * x * y,), torch.inf)
    lowest = lowest.scatter_reduce(0, hits.column, hits.features[:, 2], "amin").reshape(frames, 1, x, y)
    blocks = -functional.max_pool2d(-lowest, BLOCK)
    is_hit = blocks.isfinite()
    smooth = functional.avg_pool2d(
        filled(torch.where(is_hit, blocks, 0.0), is_hit.float()), 3, 1, padding=1, count_include_pad=False
    )
    return functional.interpolate(smooth, size=(x, y), mode="bilinear")


def filled(values: Tensor, weights: Tensor) -> Tensor:
    """Return values (B, 1, h, w) at weight (0 … 1) 1; at lower weights, mixed with the means of ever larger blocks."""
    height, width = values.shape[2:]
    if height % 2 or width % 2:
        mean = (values * weights).sum(dim=(2, 3), keepdim=True) / weights.sum(dim=(2, 3), keepdim=True).clamp(min=1e-6)
        coarse = mean.expand_as(values)
    else:
        weight = functional.avg_pool2d(weights, 2)
        mean = functional.avg_pool2d(values * weights, 2) / weight.clamp(min=1e-6)
        known = filled(mean, (4 * weight).clamp(max=1))  # one of four cells suffices for a block
        coarse = functional.interpolate(known, scale_factor=2.0, mode="bilinear")
    return weights * values + (1 - weights) * coarse


EVIDENCE = 3


def evidence_of(hits: ColumnHits, terrain: TerrainColumns, alignment: ColumnAlignment, newest_s: float) -> Tensor:
    """Return maps (B, 3 K, X, Y) of aligned heights: hits, recent hits, and mean position within the voxel.

    The first is `log(1 + points) / 3`. The second is 1 with a hit in the last `newest_s`, else 0. The third is −½ … ½.
    `features` end with the age.
    """
    x, y, _ = alignment.lattice.shape
    frames, heights = len(terrain.base), alignment.heights
    height = hits.voxel[:, 2] - terrain.base.reshape(-1)[hits.column]
    aligned = ((height >= 0) & (height < heights)).nonzero()[:, 0]
    points, column, frame = hits.features[aligned], hits.column[aligned], hits.frame[aligned]
    voxel = column + (frame * (heights - 1) + height[aligned]) * x * y  # of (B, K, X, Y)
    low, size = alignment.lattice.min_m[2], alignment.lattice.voxel_m[2]
    within = (points[:, 2] - low) / size - hits.voxel[aligned, 2] - 0.5
    sums = points.new_zeros(EVIDENCE, frames * heights * x * y)
    terms = torch.stack([torch.ones_like(within), (points[:, -1] <= newest_s).float(), within])
    count, newest, offset = sums.index_add(1, voxel, terms)
    maps = torch.stack([count.log1p() / FULL_VOXEL, newest.clamp(max=1), offset / count.clamp(min=1)])
    return maps.reshape(EVIDENCE, frames, heights, x, y).movedim(0, 1).flatten(1, 2)


STATISTICS = 11


def statistics_of(hits: ColumnHits, terrain: TerrainColumns, lattice: VoxelLattice) -> Tensor:
    """Return maps (B, 11, X, Y) of column statistics.

    They are hit or not, log count, lowest, highest, mean and deviation in m above the reference, and mean intensity.
    The others are the reference in m and within its voxel, and its slope along x and y (m / m).
    """
    reference = terrain.reference_m.reshape(-1)
    above = hits.features[:, 2] - reference[hits.column]
    count, total, squares, intensity = reference.new_zeros(4, len(reference)).index_add(
        1, hits.column, torch.stack([torch.ones_like(above), above, above**2, hits.features[:, 3]])
    )
    divisor = count.clamp(min=1)
    mean = total / divisor
    deviation = (squares / divisor - mean**2).clamp(min=0).sqrt()
    lowest = torch.zeros_like(mean).scatter_reduce(0, hits.column, above, "amin", include_self=False)
    highest = torch.zeros_like(mean).scatter_reduce(0, hits.column, above, "amax", include_self=False)
    is_hit = (count > 0).float()
    maps = torch.stack([is_hit, count.log1p() / FULL_VOXEL, lowest, highest, mean, deviation, intensity / divisor])
    return torch.cat([_unflattened(maps, terrain), *_shape_of(terrain, lattice)], dim=1)


def _unflattened(maps: Tensor, terrain: TerrainColumns) -> Tensor:
    """Return maps (S, B · X · Y) as (B, S, X, Y)."""
    return maps.reshape(len(maps), *terrain.base.shape).movedim(0, 1)


def _shape_of(terrain: TerrainColumns, lattice: VoxelLattice) -> tuple[Tensor, ...]:
    size = lattice.voxel_m
    within = (terrain.reference_m - lattice.min_m[2]) / size[2]
    padded = functional.pad(terrain.reference_m, (1, 1, 1, 1), mode="replicate")
    along_x = (padded[:, :, 2:, 1:-1] - padded[:, :, :-2, 1:-1]) / (2 * size[0])
    along_y = (padded[:, :, 1:-1, 2:] - padded[:, :, 1:-1, :-2]) / (2 * size[1])
    return terrain.reference_m, within - within.floor() - 0.5, along_x, along_y


def surface_of(hits: ColumnHits, terrain: TerrainColumns, otherwise_above_m: float) -> Tensor:
    """Return heights (B, 2, X, Y) in metres, grid frame, of the lowest and the highest point of each column.

    Columns without points have the reference and `otherwise_above_m` above it.
    """
    reference = terrain.reference_m.reshape(-1)
    lowest = reference.scatter_reduce(0, hits.column, hits.features[:, 2], "amin", include_self=False)
    above = reference + otherwise_above_m
    highest = above.scatter_reduce(0, hits.column, hits.features[:, 2], "amax", include_self=False)
    return _unflattened(torch.stack([lowest, highest]), terrain)


RADAR_STATISTICS = 5


def radar_maps(hits: ColumnHits, terrain: TerrainColumns) -> Tensor:
    """Return maps (B, 5, X, Y) of `RADAR_FEATURES`: log count, and means of height above the reference, strength,
    velocity.
    """
    reference = terrain.reference_m.reshape(-1)
    above = hits.features[:, 2] - reference[hits.column]
    terms = torch.stack([torch.ones_like(above), above, *hits.features[:, 3:6].T])
    sums = reference.new_zeros(RADAR_STATISTICS, len(reference)).index_add(1, hits.column, terms)
    maps = torch.cat([sums[:1].log1p(), sums[1:] / sums[:1].clamp(min=1)])
    return _unflattened(maps, terrain)
