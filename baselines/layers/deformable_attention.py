"""Multi-scale deformable attention in two dimensions, by bilinear sampling.

**Conventions.** A place is (column, row) as a fraction of a map's width and height: (0, 0) is the outer corner of the
first pixel, (1, 1) of the last. Maps are zero outside. Source: Zhu et al., Deformable DETR, ICLR 2021, equations 2 and
3; the ring of initial offsets is theirs too.
"""

from collections.abc import Sequence
from math import pi

import torch
from torch import Tensor, nn
from torch.nn import functional


def deformable_attention(maps: Sequence[Tensor], places: Tensor, weights: Tensor) -> Tensor:
    """Return Σ over levels and points of weight · bilinear(map, place), (B, Q, heads · c), float32 or wider.

    `maps`: one (B, heads, c, rows, columns) per level; `places` (B, Q, heads, levels, points, 2); `weights` likewise
    without the last axis. Q may be 0.
    """
    with torch.autocast(places.device.type, enabled=False):
        places = at_least_float32(places)
        levels = zip(maps, places.unbind(3), weights.to(places).unbind(3), strict=True)
        sums = [_attended(values.to(places), where, share) for values, where, share in levels]
        return torch.stack(sums).sum(dim=0)


def _attended(values: Tensor, places: Tensor, weights: Tensor) -> Tensor:
    """Return one level: (B, heads, c, rows, columns), (B, Q, heads, points, 2), (B, Q, heads, points) → (B, Q, heads ·
    c).
    """
    batch, heads = values.shape[:2]
    grid = (2 * places - 1).transpose(1, 2).flatten(0, 1)
    sampled = functional.grid_sample(values.flatten(0, 1), grid, align_corners=False)  # (B · heads, c, Q, points)
    shares = weights.transpose(1, 2).flatten(0, 1)
    attended = (sampled * shares[:, None]).sum(dim=-1)
    return torch.unflatten(attended, 0, (batch, heads)).permute(0, 3, 1, 2).flatten(2)


class SamplingHead(nn.Module):
    """The sampling places and weights of each query: offsets in pixels of the map, and scores before softmax.

    `shape` is (heads, groups, points). Initially the scores are 0 and the offsets do not depend on the query: point j
    of a head is j + 1 pixels out, each head in its own direction.
    """

    def __init__(self, channels: int, shape: tuple[int, int, int]) -> None:
        super().__init__()
        self.shape = shape
        heads, groups, points = shape
        self.offsets = nn.Linear(channels, heads * groups * points * 2)
        self.scores = nn.Linear(channels, heads * groups * points)
        self.reset_parameters()

    @torch.no_grad()
    def reset_parameters(self) -> None:
        heads, groups, points = self.shape
        turn = torch.arange(heads) * (2 * pi / heads)
        ring = torch.stack([turn.cos(), turn.sin()], dim=-1)
        ring = ring / ring.abs().amax(dim=-1, keepdim=True)
        steps = torch.arange(1, points + 1)[:, None] * ring[:, None, None]  # (heads, 1, points, 2)
        self.offsets.bias.copy_(steps.expand(heads, groups, points, 2).flatten())
        for zeroed in (self.offsets.weight, self.scores.weight, self.scores.bias):
            nn.init.zeros_(zeroed)

    def forward(self, queries: Tensor) -> tuple[Tensor, Tensor]:
        """Return offsets (…, *shape, 2), x first, and scores (…, *shape) of queries (…, channels), float32 or wider."""
        offsets, scores = at_least_float32(self.offsets(queries)), at_least_float32(self.scores(queries))
        return torch.unflatten(offsets, -1, (*self.shape, 2)), torch.unflatten(scores, -1, self.shape)


def at_least_float32(values: Tensor) -> Tensor:
    return values.to(torch.promote_types(values.dtype, torch.float32))


def by_head(values: Tensor, heads: int) -> Tensor:
    """Return maps (…, channels, rows, columns) as (…, heads, channels / heads, rows, columns)."""
    return torch.unflatten(values, -3, (heads, values.shape[-3] // heads))
