"""Focal loss over voxels: cross entropy that weighs less what is already well classified.

Source: Lin et al., Focal Loss for Dense Object Detection, ICCV 2017, equation 5, of a softmax over the classes.
"""

from torch import Tensor
from torch.nn import functional

from baselines.losses.voxels import counted


def focal_loss(logits: Tensor, labels: Tensor, gamma: float = 2.0, alpha: float = 0.25) -> Tensor:
    """Mean of `−α (1 − p)^γ log p` over the counted voxels, p that of the true class; 0 where none is counted.

    `logits` (B, C, …) and `labels` (B, …) as in `voxels.py`.
    """
    scores, classes = counted(logits, labels)
    if len(classes) == 0:
        return logits.sum() * 0.0
    surprise = functional.cross_entropy(scores, classes, reduction="none")
    return alpha * ((1 - (-surprise).exp()) ** gamma * surprise).mean()
