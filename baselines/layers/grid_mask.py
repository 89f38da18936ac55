"""GridMask: in training, squares of a random lattice are blanked in all images alike.

Source: Chen et al., GridMask Data Augmentation, arXiv 2001.04086; TPVFormer's `use_grid_mask` with its values. Half of
each period is blank along rows and along columns, so a quarter of the image, without rotation.
"""

import torch
from torch import Tensor, nn

KEPT_RATIO = 0.5  # share of a period
SHORTEST_PERIOD_PX = 2


class GridMask(nn.Module):
    """Images (…, H, W) to images; unchanged with probability 1 − `probability`, and outside training."""

    def __init__(self, probability: float) -> None:
        super().__init__()
        self.probability = probability

    def forward(self, images: Tensor) -> Tensor:
        if not self.training or torch.rand(()) >= self.probability:
            return images
        height, width = images.shape[-2:]
        period_px = int(torch.randint(SHORTEST_PERIOD_PX, max(height, SHORTEST_PERIOD_PX + 1), ()))
        rows, columns = (is_kept(n, period_px) for n in (height, width))
        return images * (rows[:, None] | columns).to(images)


def is_kept(pixels: int, period_px: int) -> Tensor:
    """Return the kept pixels of a row (pixels,): from a random start, the first `KEPT_RATIO` of every period."""
    start = torch.randint(period_px, ())
    return (torch.arange(pixels) + start) % period_px < round(KEPT_RATIO * period_px)
