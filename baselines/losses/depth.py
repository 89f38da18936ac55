"""Targets of a distribution over depth: the nearest LiDAR return in a feature cell.

**Conventions.** Probabilities (B, N, D, h, w) over the bins of a `Frustum`, depth of images (B, N, H, W) in metres, 0
without a return. Losses are means over cells with a depth in the range of the bins' middles; 0 without such cells.
Source: Li et al., BEVDepth (AAAI 2023); OpenOccupancy's `image2bev/ViewTransformerLSSVoxel.py`.
"""

import torch
from torch import Tensor
from torch.nn import functional

from baselines.layers.lifting import Frustum

DEVIATION_M = 0.5  # the target's, about the depth: `constant_std` of OpenOccupancy


def nearest_depth(depth_m: Tensor, stride: int) -> Tensor:
    """Return the least depth (B, N, H / stride, W / stride) of each cell's pixels, 0 if none has a depth."""
    count, cameras, height, width = depth_m.shape
    cells = depth_m.reshape(count, cameras, height // stride, stride, width // stride, stride)
    least = torch.where(cells > 0, cells, torch.inf).amin(dim=(3, 5))
    return torch.where(least.isfinite(), least, 0.0)


def depth_divergence(probabilities: Tensor, depth_m: Tensor, frustum: Frustum) -> Tensor:
    """Return the Kullback-Leibler divergence from a normal distribution about the depth, integrated over each bin.

    In the official code the normal distribution is in steps and the bins' edges are in metres, so that steps of 0.5 m
    put the target at twice the depth. Here both are in metres.
    """
    with torch.autocast(probabilities.device.type, enabled=False):
        depth, is_known = targets(depth_m, frustum)
        edges = frustum.depths_m(depth) - frustum.step_m / 2
        edges = torch.cat([edges, edges[-1:] + frustum.step_m])[:, None, None]
        cumulated = torch.special.ndtr((edges - depth[:, :, None]) / DEVIATION_M)
        target = cumulated.diff(dim=2)
        terms = torch.xlogy(target, target) - target * torch.log(probabilities.float() + 1e-4)
        return averaged(terms, is_known)


def depth_cross_entropy(probabilities: Tensor, depth_m: Tensor, frustum: Frustum) -> Tensor:
    """Return the binary cross entropy of all bins against the bin nearest to the depth, summed over bins.

    In the official code the target is the bin before the nearest one.
    """
    with torch.autocast(probabilities.device.type, enabled=False):
        depth, is_known = targets(depth_m, frustum)
        nearest = ((depth - frustum.min_m) / frustum.step_m).round().long().clamp(0, frustum.bins - 1)
        target = functional.one_hot(nearest, frustum.bins).movedim(-1, 2).float()
        terms = functional.binary_cross_entropy(probabilities.float(), target, reduction="none")
        return averaged(terms, is_known)


def targets(depth_m: Tensor, frustum: Frustum) -> tuple[Tensor, Tensor]:
    """Return the depth (B, N, h, w), float32, and whether it is in the bins' range."""
    depth = nearest_depth(depth_m.float(), frustum.stride)
    return depth, (depth >= frustum.min_m) & (depth <= frustum.max_m - frustum.step_m)


def averaged(terms: Tensor, is_known: Tensor) -> Tensor:
    """Return the sum over bins of terms (B, N, D, h, w), averaged over known cells."""
    sums = torch.where(is_known, terms.sum(dim=2), 0.0)
    return sums.sum() / is_known.sum().clamp(min=1)
