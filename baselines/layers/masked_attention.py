"""Mask2Former's transformer decoder: queries that become masks with a class, each attending inside its mask.

**Conventions.** Q queries, N voxels. A query attends to one memory after another, the coarsest first, and there only to
voxels that its current mask covers, or to all if it covers none. Masks are logits on the finest level.

Source: Cheng et al., Mask2Former, CVPR 2022, section 3.2; for volumes, with the mask max-pooled so that rare classes
keep theirs: zhangyp15/OccFormer, mask2former/mask2former_occ.py (`Mask2FormerOccHead`, SemanticKITTI's).
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import adaptive_max_pool3d

from baselines.lattice import Shape
from baselines.layers.pixel_decoder3d import Levels, shape_of, sine_positions


@dataclass(frozen=True)
class QuerySettings:
    """`classes` without the class "no object"; `hidden` within the feed-forward networks."""

    classes: int = 4
    queries: int = 100
    channels: int = 192
    heads: int = 6
    layers: int = 9
    levels: int = 3
    hidden: int = 1536


@dataclass(frozen=True, eq=False)
class MaskPrediction:
    """`classes` (B, Q, C + 1) logits, the last of no object; `masks` (B, Q, X, Y, Z) logits."""

    classes: Tensor
    masks: Tensor


@dataclass(frozen=True, eq=False)
class MemoryTokens:
    """The attended tokens: `tokens` (B, N, C), and `keys`, which are tokens with positions added."""

    tokens: Tensor
    keys: Tensor


class MaskDecoder(nn.Module):
    """Features of masks (B, C, X, Y, Z) and memories → the queries' predictions at first, and after each layer."""

    def __init__(self, settings: QuerySettings) -> None:
        super().__init__()
        channels = settings.channels
        self.heads = settings.heads
        self.query = nn.Embedding(settings.queries, channels)
        self.query_position = nn.Embedding(settings.queries, channels)
        self.level = nn.Embedding(settings.levels, channels)
        self.layers = nn.ModuleList(MaskDecoderLayer(settings) for _ in range(settings.layers))
        self.norm = nn.LayerNorm(channels)
        self.classes = nn.Linear(channels, settings.classes + 1)
        self.mask = nn.Sequential(
            nn.Linear(channels, channels), nn.ReLU(inplace=True),
            nn.Linear(channels, channels), nn.ReLU(inplace=True),
            nn.Linear(channels, channels),
        )  # fmt: skip

    def forward(self, features: Tensor, memories: Levels) -> tuple[MaskPrediction, ...]:
        looked_at = [self._memory(n, memory) for n, memory in enumerate(memories)]
        queries = self.query.weight.expand(len(features), -1, -1)
        predictions = [self._predicted(queries, features)]
        for number, layer in enumerate(self.layers):
            level = number % len(memories)
            hidden = hidden_voxels(predictions[-1].masks, shape_of(memories[level]))
            hidden = hidden.repeat_interleave(self.heads, dim=0)
            queries = layer(queries, self.query_position.weight, looked_at[level], hidden)
            predictions.append(self._predicted(queries, features))
        return tuple(predictions)

    def _memory(self, level: int, volume: Tensor) -> MemoryTokens:
        tokens = volume.flatten(2).transpose(1, 2) + self.level.weight[level]
        return MemoryTokens(tokens, tokens + sine_positions(shape_of(volume), volume.shape[1], volume.device))

    def _predicted(self, queries: Tensor, features: Tensor) -> MaskPrediction:
        queries = self.norm(queries)
        masks = torch.einsum("bqc,bcxyz->bqxyz", self.mask(queries), features)
        return MaskPrediction(self.classes(queries), masks)


class MaskDecoderLayer(nn.Module):
    """Attention to a memory, attention among the queries, a feed-forward network; each added and normalised."""

    def __init__(self, settings: QuerySettings) -> None:
        super().__init__()
        channels = settings.channels
        self.across = nn.MultiheadAttention(channels, settings.heads, batch_first=True)
        self.among = nn.MultiheadAttention(channels, settings.heads, batch_first=True)
        self.feed_forward = nn.Sequential(
            nn.Linear(channels, settings.hidden), nn.ReLU(inplace=True), nn.Linear(settings.hidden, channels)
        )
        self.norms = nn.ModuleList(nn.LayerNorm(channels) for _ in range(3))
        for parameter in self.parameters():
            if parameter.dim() > 1:
                nn.init.xavier_normal_(parameter)

    def forward(self, queries: Tensor, query_position: Tensor, memory: MemoryTokens, hidden: Tensor) -> Tensor:
        """Return the updated queries; `queries` (B, Q, C), their positions (Q, C), and `hidden` (B · heads, Q, N),
        masked tokens.
        """
        positioned = queries + query_position
        seen, _ = self.across(positioned, memory.keys, memory.tokens, attn_mask=hidden, need_weights=False)
        queries = self.norms[0](queries + seen)
        positioned = queries + query_position
        attended, _ = self.among(positioned, positioned, queries, need_weights=False)
        queries = self.norms[1](queries + attended)
        answered: Tensor = self.norms[2](queries + self.feed_forward(queries))
        return answered


def hidden_voxels(masks: Tensor, shape: Shape) -> Tensor:
    """Return the voxels of a coarser volume (B, Q, N) outside each mask (probability ≤ ½); none if that is all."""
    hidden = adaptive_max_pool3d(masks.detach().float(), shape).flatten(2) < 0.0
    return hidden & ~hidden.all(dim=2, keepdim=True)
