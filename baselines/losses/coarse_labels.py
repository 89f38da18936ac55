"""Labels of coarse cells, made of their voxels' labels."""

import torch
from torch import Tensor
from torch.nn import functional

from baselines.batch import IGNORED


def coarse_labels(labels: Tensor, ratio: int, classes: int = 4) -> Tensor:
    """Each cell's most frequent occupied class; free where all its voxels are, ignored where none says more.

    Labels (B, X, Y, Z) uint8 to (B, X / ratio, Y / ratio, Z / ratio) uint8. The lower class wins where two are as
    frequent. OpenOccupancy's `OccHead.loss_voxel`, but for a cell of which all occupied classes occur once: it is
    ignored there, since each free voxel counts as a class of its own and the lowest is taken.
    """
    if ratio == 1:
        return labels
    counts = torch.stack([share(labels == c, ratio) for c in range(1, classes)])
    most, winner = (counts * classes - torch.arange(classes - 1, device=labels.device).view(-1, 1, 1, 1, 1)).max(dim=0)
    is_occupied = most > 0
    is_ignored = ~is_occupied & (share(labels == IGNORED, ratio) > 0)
    return torch.where(is_occupied, winner + 1, torch.where(is_ignored, IGNORED, 0)).to(torch.uint8)


def share(is_so: Tensor, ratio: int) -> Tensor:
    """How many voxels (B, X, Y, Z) of each cell it is so of, float32."""
    return torch.round(functional.avg_pool3d(is_so[:, None].float(), ratio)[:, 0] * ratio**3)
