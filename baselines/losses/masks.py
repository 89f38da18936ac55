"""Loss of masks with classes: each class of a frame is assigned to one query, which predicts its class and its voxels.

**Conventions.** Q queries, C classes, G classes present in a frame, the "no object" class last. Everything is float32.
In a frame without a labelled voxel the target of all queries is "no object".

Source: Cheng et al., MaskFormer, NeurIPS 2021, section 3.2, and Mask2Former, CVPR 2022, section 3.3; weights and class
balance of zhangyp15/OccFormer, mask2former/mask2former_occ.py and configs/occformer_kitti/occformer_kitti.py.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import log

import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor
from torch.nn import functional

from baselines.lattice import Shape
from baselines.layers.masked_attention import MaskPrediction

# Sampled voxels of mask losses: few of a lattice's, with rare classes and undecided places more often. Voxels are flat
# indices into labels (X, Y, Z), C order. A mask may be coarser than the labels and is read trilinearly. All randomness
# is torch's, on the device of the labels: the same seed draws the same voxels. Source: Kirillov et al., PointRend, CVPR
# 2020, section 3.1; Zhang et al., OccFormer, ICCV 2023, section 3.3 (class-guided sampling); zhangyp15/OccFormer,
# mask2former/base/mmdet_utils.py.


@dataclass(frozen=True)
class PointSettings:
    """`points` voxels per mask: the share `uncertain_ratio` is the least decided ones, the rest is drawn uniformly.

    The least decided are chosen from `oversampling` times as many drawn by class. A class is drawn in proportion to its
    rarity to the power `rarity_exponent`.

    `align_corners`: centres of the corner voxels of mask and labels coincide, as in the official training and
    inference. A mask is then stretched by half a voxel of the labels at its borders. Otherwise the volumes' corners
    coincide.
    """

    points: int = 4 * 12_544
    oversampling: float = 3.0
    uncertain_ratio: float = 0.75
    rarity_exponent: float = 0.25
    align_corners: bool = True


@dataclass(frozen=True, eq=False)
class FrameMasks:
    """Targets of one frame: `classes` (G,) int64, `masks` (G, X·Y·Z) bool, `rarity` (X·Y·Z,), 0 if ignored."""

    classes: Tensor
    masks: Tensor
    rarity: Tensor
    shape: Shape


def frame_masks(labels: Tensor, rarity: Tensor) -> FrameMasks:
    """Return the classes of `labels` (X, Y, Z), each with all its voxels; `rarity` (C,) is the sampling weight of each
    class.

    Other values, such as `IGNORED`, are never drawn.
    """
    x, y, z = labels.shape
    flat = labels.flatten()
    is_counted = flat < len(rarity)
    classes = torch.unique(flat[is_counted]).long()
    drawn = torch.where(is_counted, rarity[torch.where(is_counted, flat, 0).long()], 0.0)
    return FrameMasks(classes, flat == classes[:, None], drawn, (x, y, z))


def drawn_voxels(weights: Tensor, masks: int, count: int) -> Tensor:
    """Return (masks, n): for each mask n different voxels by `weights` (V,); all voxels of positive weight if they are
    fewer.
    """
    available = int(torch.count_nonzero(weights))
    return torch.multinomial(weights.expand(masks, -1), min(count, available), replacement=False)


def contested_voxels(masks: Tensor, frame: FrameMasks, settings: PointSettings) -> Tensor:
    """Return (G, n): the sampled voxels of the loss of each mask (G, x, y, z)."""
    uncertain = int(settings.uncertain_ratio * settings.points)
    candidates = drawn_voxels(frame.rarity, len(masks), int(settings.oversampling * settings.points))
    logits = read_masks(masks[:, None], candidates, frame.shape, settings.align_corners)[:, 0]
    least = logits.abs().topk(min(uncertain, candidates.shape[1]), largest=False).indices
    anywhere = drawn_voxels((frame.rarity > 0).float(), len(masks), settings.points - uncertain)
    return torch.cat((candidates.gather(1, least), anywhere), dim=1)


def read_masks(masks: Tensor, voxels: Tensor, shape: Shape, align_corners: bool) -> Tensor:
    """Return masks (M, C, x, y, z) at voxels (M, P) of a lattice of `shape`: (M, C, P)."""
    x, y, z = torch.unravel_index(voxels, shape)
    position = torch.stack((z, y, x), dim=-1).to(masks.dtype)
    size = position.new_tensor(shape).flip(0)
    grid = 2.0 * position / (size - 1.0).clamp_min(1.0) if align_corners else (2.0 * position + 1.0) / size
    grid = (grid - 1.0)[:, :, None, None]
    return functional.grid_sample(masks, grid, padding_mode="border", align_corners=align_corners)[:, :, :, 0, 0]


@dataclass(frozen=True)
class MaskLossSettings:
    """`class_counts`: labelled voxels of each class in the training split, each more than one."""

    class_counts: tuple[int, ...]
    points: PointSettings = field(default_factory=PointSettings)
    no_object_weight: float = 0.1
    class_weight: float = 2.0
    mask_weight: float = 5.0
    dice_weight: float = 5.0

    def __post_init__(self) -> None:
        if min(self.class_counts) <= 1:
            raise ValueError(f"each class must have more than one voxel for its weight, not {self.class_counts}")

    def class_weights(self) -> list[float]:
        """Return (C + 1) weights: 1 / ln(voxels), the first class's 1, and the weight of no object."""
        return [log(self.class_counts[0]) / log(voxels) for voxels in self.class_counts] + [self.no_object_weight]

    def rarity(self) -> list[float]:
        """Return (C) sampling weights of a voxel of each class, the commonest class's 1."""
        return [(max(self.class_counts) / voxels) ** self.points.rarity_exponent for voxels in self.class_counts]


def mask_losses(predictions: Sequence[MaskPrediction], labels: Tensor, settings: MaskLossSettings) -> dict[str, Tensor]:
    """Return the terms `class`, `mask` and `dice`, weighted, summed over all predictions; `labels` (B, X, Y, Z)."""
    rarity = torch.tensor(settings.rarity(), device=labels.device)
    frames = [frame_masks(frame, rarity) for frame in labels]
    with torch.autocast(labels.device.type, enabled=False):
        terms = torch.stack([losses_of(prediction, frames, settings) for prediction in predictions]).sum(dim=0)
    return {"class": terms[0], "mask": terms[1], "dice": terms[2]}


def losses_of(prediction: MaskPrediction, frames: Sequence[FrameMasks], settings: MaskLossSettings) -> Tensor:
    """Return the three terms of one prediction, (3,)."""
    weights = torch.tensor(settings.class_weights(), device=prediction.classes.device)
    assigned = torch.full(prediction.classes.shape[:2], len(settings.class_counts), device=weights.device)
    terms = []
    for number, frame in enumerate(frames):
        classes, masks = prediction.classes[number].float(), prediction.masks[number].float()
        queries = matched_queries(classes.detach(), masks.detach(), frame, settings)
        assigned[number, queries] = frame.classes
        terms.append(losses_of_masks(masks[queries], frame, settings.points))
    of_class = functional.cross_entropy(prediction.classes.float().flatten(0, 1), assigned.flatten(), weights)
    weight = weights[torch.cat([frame.classes for frame in frames])]
    mask, dice = (torch.cat(terms, dim=1) * weight).sum(dim=1) / weight.sum().clamp_min(torch.finfo(torch.float32).eps)
    return torch.stack((settings.class_weight * of_class, settings.mask_weight * mask, settings.dice_weight * dice))


def losses_of_masks(masks: Tensor, frame: FrameMasks, settings: PointSettings) -> Tensor:
    """Return cross entropy and dice (2, G) of logits (G, x, y, z), each against the class of its row."""
    if len(masks) == 0:
        return masks.sum(dim=(1, 2, 3)).expand(2, -1)  # empty, but still a function of the masks
    with torch.no_grad():
        voxels = contested_voxels(masks, frame, settings)
        targets = frame.masks.gather(1, voxels).float()
    logits = read_masks(masks[:, None], voxels, frame.shape, settings.align_corners)[:, 0]
    cross_entropy = functional.binary_cross_entropy_with_logits(logits, targets, reduction="none").mean(dim=1)
    covered = logits.sigmoid()
    shared, either = (covered * targets).sum(dim=1), covered.sum(dim=1) + targets.sum(dim=1)
    return torch.stack((cross_entropy, dice_loss(shared, either)))


@torch.no_grad()
def matched_queries(classes: Tensor, masks: Tensor, frame: FrameMasks, settings: MaskLossSettings) -> Tensor:
    """Return the query (G,) of each class present, with the least total cost; `classes` (Q, C + 1) and `masks`."""
    if len(frame.classes) == 0:
        return frame.classes
    points = settings.points
    voxels = drawn_voxels(frame.rarity, 1, points.points)
    logits = read_masks(masks[None], voxels, frame.shape, points.align_corners)[0]
    cost = matching_cost(classes, logits, frame.classes, frame.masks[:, voxels[0]].float(), settings)
    _, queries = linear_sum_assignment(cost.T.cpu().numpy())
    return torch.as_tensor(queries, device=classes.device)


def matching_cost(
    classes: Tensor, logits: Tensor, present: Tensor, targets: Tensor, settings: MaskLossSettings
) -> Tensor:
    """Return (Q, G): the cost of each query for each class present; `logits` (Q, P), `targets` (G, P)."""
    unlikely = -classes.softmax(dim=1)[:, present]
    inside = functional.softplus(-logits) @ targets.T + functional.softplus(logits) @ (1.0 - targets).T
    covered = logits.sigmoid()
    apart = dice_loss(covered @ targets.T, covered.sum(dim=1)[:, None] + targets.sum(dim=1)[None, :])
    return (
        settings.class_weight * unlikely
        + settings.mask_weight * inside / logits.shape[1]
        + settings.dice_weight * apart
    )


def dice_loss(shared: Tensor, either: Tensor) -> Tensor:
    """Return 1 − (2·|A ∩ B| + 1) / (|A| + |B| + 1)."""
    return 1.0 - (2.0 * shared + 1.0) / (either + 1.0)
