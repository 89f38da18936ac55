"""Voxels that losses of masks are taken at: few of a lattice's, rare classes and undecided places more often.

**Conventions.** Voxels are flat indices into labels (X, Y, Z), C order. A mask may be coarser than the labels and is
read trilinearly. All chance is torch's, on the device of the labels: the same seed draws the same voxels.

Source: Kirillov et al., PointRend, CVPR 2020, section 3.1; Zhang et al., OccFormer, ICCV 2023, section 3.3
(class-guided sampling); zhangyp15/OccFormer, mask2former/base/mmdet_utils.py.
"""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from baselines.lattice import Shape


@dataclass(frozen=True)
class PointSettings:
    """`points` voxels for a mask: the least decided `uncertain_ratio` of them out of `oversampling` times as many drawn
    by class, the others drawn uniformly. A class is drawn in proportion to its rarity to the power `rarity_exponent`.

    `align_corners`: centres of the corner voxels of mask and labels coincide, as in the official training and
    inference, so that a mask is stretched by half a voxel of the labels at its borders; else the volumes' corners do.
    """

    points: int = 4 * 12_544
    oversampling: float = 3.0
    uncertain_ratio: float = 0.75
    rarity_exponent: float = 0.25
    align_corners: bool = True


@dataclass(frozen=True, eq=False)
class FrameMasks:
    """What there is in one frame: `classes` (G,) int64, `masks` (G, X·Y·Z) bool, `rarity` (X·Y·Z,), 0 if ignored."""

    classes: Tensor
    masks: Tensor
    rarity: Tensor
    shape: Shape


def frame_masks(labels: Tensor, rarity: Tensor) -> FrameMasks:
    """The classes of `labels` (X, Y, Z), each with all its voxels; `rarity` (C,) says how much each class is drawn.

    What is none of the C classes, as `IGNORED`, is drawn nowhere.
    """
    x, y, z = labels.shape
    flat = labels.flatten()
    is_counted = flat < len(rarity)
    classes = torch.unique(flat[is_counted]).long()
    drawn = torch.where(is_counted, rarity[torch.where(is_counted, flat, 0).long()], 0.0)
    return FrameMasks(classes, flat == classes[:, None], drawn, (x, y, z))


def drawn_voxels(weights: Tensor, masks: int, count: int) -> Tensor:
    """(masks, n): for each mask n different voxels by `weights` (V,); all that weigh anything where they are fewer."""
    available = int(torch.count_nonzero(weights))
    return torch.multinomial(weights.expand(masks, -1), min(count, available), replacement=False)


def contested_voxels(masks: Tensor, frame: FrameMasks, settings: PointSettings) -> Tensor:
    """(G, n): the voxels at which the loss of each mask (G, x, y, z) is taken."""
    uncertain = int(settings.uncertain_ratio * settings.points)
    candidates = drawn_voxels(frame.rarity, len(masks), int(settings.oversampling * settings.points))
    logits = read_masks(masks[:, None], candidates, frame.shape, settings.align_corners)[:, 0]
    least = logits.abs().topk(min(uncertain, candidates.shape[1]), largest=False).indices
    anywhere = drawn_voxels((frame.rarity > 0).float(), len(masks), settings.points - uncertain)
    return torch.cat((candidates.gather(1, least), anywhere), dim=1)


def read_masks(masks: Tensor, voxels: Tensor, shape: Shape, align_corners: bool) -> Tensor:
    """Masks (M, C, x, y, z) at voxels (M, P) of a lattice of `shape`: (M, C, P)."""
    x, y, z = torch.unravel_index(voxels, shape)
    place = torch.stack((z, y, x), dim=-1).to(masks.dtype)
    size = place.new_tensor(shape).flip(0)
    grid = 2.0 * place / (size - 1.0).clamp_min(1.0) if align_corners else (2.0 * place + 1.0) / size
    grid = (grid - 1.0)[:, :, None, None]
    return functional.grid_sample(masks, grid, padding_mode="border", align_corners=align_corners)[:, :, :, 0, 0]
