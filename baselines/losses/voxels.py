"""Losses over voxels: weighted cross entropy, scene-class affinity (semantic and geometric) and Lovász-softmax.

**Conventions.** `logits` (B, C, ...) and `labels` (B, ...) with `IGNORED` for uncounted voxels: voxels of a lattice, or
single ones, (N, C) and (N,). All compute in float32 at least. Without a counted label a loss is 0, with a gradient of
zeros. Sources: Cao and de Charette, MonoScene, CVPR 2022, section 3.3; Berman et al., The Lovász-Softmax loss, CVPR
2018; as in OpenOccupancy's `occ_plugin/utils/semkitti.py`.
"""

import torch
from torch import Tensor
from torch.nn import functional

from baselines.batch import IGNORED

FREE = 0
SMALLEST_RATIO = 1e-30  # its logarithm is finite in float32
GEOMETRIC_EPSILON = 1e-5  # official


def cross_entropy(logits: Tensor, labels: Tensor, class_weights: Tensor | None = None) -> Tensor:
    """Return the mean of −w log p over the counted voxels, divided by the mean weight; `class_weights` (C,)."""
    if not bool((labels != IGNORED).any()):
        return logits.sum() * 0.0
    scores = logits if logits.dtype == torch.float64 else logits.float()
    weights = None if class_weights is None else class_weights.to(scores)
    return functional.cross_entropy(scores, labels.long(), weights, ignore_index=IGNORED)


def semantic_scale(logits: Tensor, labels: Tensor) -> Tensor:
    """Return the mean over occurring classes of −log precision − log recall − log specificity, softly counted."""
    scores, classes = counted(logits, labels)
    if len(classes) == 0:
        return logits.sum() * 0.0
    probabilities = scores.softmax(dim=1)
    truth = functional.one_hot(classes, scores.shape[1]).to(scores)
    hits, predicted, true = (probabilities * truth).sum(0), probabilities.sum(0), truth.sum(0)
    false = len(classes) - true
    rejected = ((1 - probabilities) * (1 - truth)).sum(0)
    terms = surprise(hits / predicted.clamp(min=SMALLEST_RATIO)) + surprise(hits / true.clamp(min=1))
    terms = terms + torch.where(false > 0, surprise(rejected / false.clamp(min=1)), 0.0)
    return terms[true > 0].mean()


def geometric_scale(logits: Tensor, labels: Tensor) -> Tensor:
    """Return the sum of the same three terms of occupied against free."""
    scores, classes = counted(logits, labels)
    if len(classes) == 0:
        return logits.sum() * 0.0
    free = scores.softmax(dim=1)[:, FREE]
    is_occupied = (classes != FREE).to(scores)
    hits = (is_occupied * (1 - free)).sum()
    precision = hits / ((1 - free).sum() + GEOMETRIC_EPSILON)
    recall = hits / (is_occupied.sum() + GEOMETRIC_EPSILON)
    specificity = ((1 - is_occupied) * free).sum() / ((1 - is_occupied).sum() + GEOMETRIC_EPSILON)
    return surprise(precision) + surprise(recall) + surprise(specificity)


def lovasz_softmax(logits: Tensor, labels: Tensor) -> Tensor:
    """Return the mean over occurring classes of the Lovász extension of 1 − IoU at the errors |truth − p|."""
    scores, classes = counted(logits, labels)
    if len(classes) == 0:
        return logits.sum() * 0.0
    probabilities = scores.softmax(dim=1)
    terms = [lovasz_extension(probabilities[:, c], classes == c) for c in torch.unique(classes).tolist()]
    return torch.stack(terms).mean()


def lovasz_extension(probabilities: Tensor, is_class: Tensor) -> Tensor:
    """Return the extension of one class's Jaccard loss: errors, largest first, times their increments of the loss."""
    truth = is_class.to(probabilities)
    errors, order = (truth - probabilities).abs().sort(descending=True)
    truth = truth[order]
    total = truth.sum()
    jaccard = 1 - (total - truth.cumsum(0)) / (total + (1 - truth).cumsum(0))
    return errors @ torch.diff(jaccard, prepend=jaccard.new_zeros(1))


def counted(logits: Tensor, labels: Tensor) -> tuple[Tensor, Tensor]:
    """Return logits (M, C), at least float32, and labels (M,) int64 of the voxels that are not `IGNORED`."""
    scores = logits if logits.dtype == torch.float64 else logits.float()
    is_counted = labels != IGNORED
    return scores.movedim(1, -1)[is_counted], labels[is_counted].long()


def surprise(ratio: Tensor) -> Tensor:
    """Return −log of a ratio in (0, 1]; flat below 1e-30. A ratio above 1 by rounding counts as 1."""
    return -ratio.clamp(SMALLEST_RATIO, 1.0).log()


# Focal loss over voxels: cross entropy with lower weights of well-classified voxels. Source: Lin et al., Focal Loss for
# Dense Object Detection, ICCV 2017, equation 5, of a softmax over the classes.


def focal_loss(logits: Tensor, labels: Tensor, gamma: float = 2.0, alpha: float = 0.25) -> Tensor:
    """Return the mean of `−α (1 − p)^γ log p` over the counted voxels, p of the true class; 0 without counted voxels.

    `logits` (B, C, …) and `labels` (B, …) as in `voxels.py`.
    """
    scores, classes = counted(logits, labels)
    if len(classes) == 0:
        return logits.sum() * 0.0
    surprise = functional.cross_entropy(scores, classes, reduction="none")
    return alpha * ((1 - (-surprise).exp()) ** gamma * surprise).mean()


# Labels of coarse cells, computed from their voxels' labels.


def coarse_labels(labels: Tensor, ratio: int, classes: int = 4) -> Tensor:
    """Return each cell's most frequent occupied class: free if all its voxels are, ignored if undecided.

    Labels (B, X, Y, Z) uint8 to (B, X / ratio, Y / ratio, Z / ratio) uint8. The lower of equally frequent classes wins.
    OpenOccupancy's `OccHead.loss_voxel` differs for a cell whose occupied classes all occur once. It ignores the cell,
    since each free voxel counts as a class of its own and the lowest is taken.
    """
    if ratio == 1:
        return labels
    counts = torch.stack([share(labels == c, ratio) for c in range(1, classes)])
    most, winner = (counts * classes - torch.arange(classes - 1, device=labels.device).view(-1, 1, 1, 1, 1)).max(dim=0)
    is_occupied = most > 0
    is_ignored = ~is_occupied & (share(labels == IGNORED, ratio) > 0)
    return torch.where(is_occupied, winner + 1, torch.where(is_ignored, IGNORED, 0)).to(torch.uint8)


def share(is_so: Tensor, ratio: int) -> Tensor:
    """Return the number of true voxels (B, X, Y, Z) of each cell, float32."""
    return torch.round(functional.avg_pool3d(is_so[:, None].float(), ratio)[:, 0] * ratio**3)
