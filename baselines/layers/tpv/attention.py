"""The two attentions of TPVFormer: from the top plane to itself, and from all planes to the images.

Source: Huang et al., CVPR 2023, section 3.3; wzzheng/TPVFormer tpvformer04/modules/cross_view_hybrid_attention.py and
image_cross_attention.py. Two differences: the visible cells are computed for each frame (there for the first of the
batch), and nothing is padded to the camera that sees most.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from baselines.layers.deformable_attention import SamplingHead, at_least_float32, by_head, deformable_attention
from baselines.layers.tpv.camera_sight import ColumnSights, Sight

SETS = 2  # sets of points: BEVFormer reads the previous and this map, TPVFormer twice this one


@dataclass(frozen=True)
class PlaneAttentionConfig:
    """`anchors` per cell of the top, front and side plane, `points` places around each of them."""

    channels: int = 256
    heads: int = 8
    levels: int = 4
    anchors: tuple[int, int, int] = (4, 32, 32)
    points: int = 2
    self_points: int = 4
    dropout: float = 0.1


class CrossViewHybridAttention(nn.Module):
    """Deformable self-attention of the top plane, with the query's content beside its position."""

    def __init__(self, config: PlaneAttentionConfig) -> None:
        super().__init__()
        self.heads = config.heads
        self.sampling = SamplingHead(SETS * config.channels, (config.heads, SETS, config.self_points))
        self.values = projection(config.channels)
        self.output = projection(config.channels)
        self.dropout = nn.Dropout(config.dropout)

    def forward(self, cells: Tensor, positions: Tensor, size: tuple[int, int]) -> Tensor:
        """Return updated cells from cells (B, rows · columns, C) and their positions (rows · columns, C)."""
        values = self.values(cells).transpose(1, 2).unflatten(2, size)
        offsets, scores = self.sampling(torch.cat([cells, cells + positions], dim=-1))
        scale = torch.tensor((size[1], size[0]), device=cells.device)
        places = cell_centres(size, cells.device)[:, None, None, None] + offsets / scale
        weights = scores.softmax(dim=-1) / SETS
        sampled = deformable_attention(
            [by_head(values, self.heads)], places.flatten(3, 4)[:, :, :, None], weights.flatten(3, 4)[:, :, :, None]
        )
        attended: Tensor = self.dropout(self.output(sampled))
        return cells + attended


class ImageCrossAttention(nn.Module):
    """Each cell attends around its anchors in the images of the cameras that see an anchor; the mean over these
    cameras.

    A cell outside all images gets the output layer's bias.
    """

    def __init__(self, config: PlaneAttentionConfig) -> None:
        super().__init__()
        self.heads, self.levels = config.heads, config.levels
        self.sampling = nn.ModuleList(
            [SamplingHead(config.channels, (config.heads, config.levels * n, config.points)) for n in config.anchors]
        )
        self.values = projection(config.channels)
        self.output = projection(config.channels)
        self.dropout = nn.Dropout(config.dropout)

    def forward(self, cells: Tensor, features: Sequence[Tensor], sights: Sequence[ColumnSights]) -> Tensor:
        """Return cells from cells (B, of all planes one after another, C) and features of a level (B, N, C, rows,
        columns).
        """
        values = [by_head(self.values(level.movedim(2, -1)).movedim(-1, 2), self.heads) for level in features]
        planes = torch.split(cells, [plane.cameras.shape[1] for plane in sights], dim=1)
        answers = [self._of_plane(*parts, values) for parts in zip(self.sampling, planes, sights, strict=True)]
        attended: Tensor = self.dropout(self.output(torch.cat(answers, dim=1)))
        return cells + attended

    def _of_plane(self, sampling: nn.Module, cells: Tensor, plane: ColumnSights, values: Sequence[Tensor]) -> Tensor:
        """Return the mean (B, Q, C) over the cameras that see a cell, float32 or wider; 0 if none does."""
        frames = []
        for frame, cameras in enumerate(plane.sights):
            total = torch.zeros_like(at_least_float32(cells[frame]))
            for camera, sight in enumerate(cameras):
                maps = [level[frame, camera][None] for level in values]
                seeing = cells[frame, sight.columns]
                total = total.index_add(0, sight.columns, self._of_camera(sampling(seeing), sight, maps))
            frames.append(total)
        return torch.stack(frames) / plane.cameras.clamp(min=1)[..., None]

    def _of_camera(self, sampled: tuple[Tensor, Tensor], sight: Sight, maps: Sequence[Tensor]) -> Tensor:
        """Return the attention of S cells to one image, (S, C)."""
        offsets, scores = sampled  # (S, heads, levels · anchors, points, 2)
        weights = torch.unflatten(scores.flatten(2).softmax(dim=-1), 2, (self.levels, -1))
        sizes = torch.tensor([(level.shape[-1], level.shape[-2]) for level in maps], device=offsets.device)
        around = torch.unflatten(offsets, 2, (self.levels, -1)) / sizes[:, None, None]
        places = sight.places[:, None, None, :, None] + around
        return deformable_attention(maps, places.flatten(3, 4)[None], weights[None])[0]


def cell_centres(size: tuple[int, int], device: torch.device) -> Tensor:
    """Return the centres (rows · columns, 2) of a map's cells as fractions of it, column first."""
    rows, columns = ((torch.arange(n, device=device, dtype=torch.float32) + 0.5) / n for n in size)
    return torch.stack(torch.meshgrid(rows, columns, indexing="ij"), dim=-1).flip(-1).flatten(0, 1)


def projection(channels: int) -> nn.Linear:
    """Return a linear layer initialised like Deformable DETR's: Xavier, without bias."""
    layer = nn.Linear(channels, channels)
    nn.init.xavier_uniform_(layer.weight)
    nn.init.zeros_(layer.bias)
    return layer
