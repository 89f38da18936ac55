"""Shifted-window attention over 2D maps: one block of a Swin transformer.

**Conventions.** Maps are (N, C, H, W), internally (N, H, W, C). A map is padded with zeros at its ends to whole
windows, and the padding takes part like any cell.

Source: Liu et al., Swin Transformer, ICCV 2021, sections 3.1 and 3.2; as in OccFormer, with a feed-forward network no
wider than its input (zhangyp15/OccFormer, backbones/modules/window_attention.py).
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional


@dataclass(frozen=True)
class WindowSettings:
    """Windows of `window` × `window` cells; every head attends in `head_channels`; a branch is dropped at random."""

    window: int = 7
    head_channels: int = 32
    drop_path: float = 0.2


class ShiftedWindowBlock(nn.Module):
    """Attention within windows, then a feed-forward network, both added to their input: (N, C, H, W) → the same."""

    def __init__(self, channels: int, is_shifted: bool, settings: WindowSettings) -> None:
        super().__init__()
        self.window, self.drop_path = settings.window, settings.drop_path
        self.shift = settings.window // 2 if is_shifted else 0
        self.norm1 = nn.LayerNorm(channels)
        self.attention = WindowAttention(channels, channels // settings.head_channels, settings.window)
        self.norm2 = nn.LayerNorm(channels)
        self.feed_forward = nn.Sequential(nn.Linear(channels, channels), nn.GELU(), nn.Linear(channels, channels))

    def forward(self, maps: Tensor) -> Tensor:
        cells = maps.permute(0, 2, 3, 1)
        cells = cells + self._dropped(self._attended(self.norm1(cells)))
        cells = cells + self._dropped(self.feed_forward(self.norm2(cells)))
        return cells.permute(0, 3, 1, 2).contiguous()

    def _attended(self, cells: Tensor) -> Tensor:
        height, width = cells.shape[1:3]
        padded = functional.pad(cells, (0, 0, 0, -width % self.window, 0, -height % self.window))
        size = (padded.shape[1], padded.shape[2])
        is_apart = None
        if self.shift:
            padded = padded.roll((-self.shift, -self.shift), (1, 2))
            is_apart = parted_by_the_roll(size, self.window, self.shift).to(cells.device)
        attended = maps_of(self.attention(windows_of(padded, self.window), is_apart), size)
        return attended.roll((self.shift, self.shift), (1, 2))[:, :height, :width]

    def _dropped(self, branch: Tensor) -> Tensor:
        return stochastic_depth(branch, self.drop_path if self.training else 0.0)


class WindowAttention(nn.Module):
    """Attention among the cells of each window, with a learned bias by their relative position."""

    pairs: Tensor

    def __init__(self, channels: int, heads: int, window: int) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(channels, 3 * channels)
        self.project = nn.Linear(channels, channels)
        self.bias = nn.Parameter(torch.zeros((2 * window - 1) ** 2, heads))
        self.register_buffer("pairs", relative_positions(window), persistent=False)

    def forward(self, windows: Tensor, is_apart: Tensor | None) -> Tensor:
        """Return (N, W, S, C); `is_apart` (W, S, S) marks pairs of cells of a window that must not attend to each
        other.
        """
        n, count, cells, _ = windows.shape
        q, k, v = self.qkv(windows).reshape(n, count, cells, 3, self.heads, -1).permute(3, 0, 1, 4, 2, 5)
        bias = self.bias[self.pairs].permute(2, 0, 1)
        if is_apart is not None:
            bias = bias.masked_fill(is_apart[:, None], float("-inf"))
        attended = functional.scaled_dot_product_attention(q, k, v, attn_mask=bias.to(q.dtype))
        projected: Tensor = self.project(attended.transpose(2, 3).flatten(3))
        return projected


def windows_of(cells: Tensor, window: int) -> Tensor:
    """Return (N, H, W, C) in windows (N, H·W / window², window², C), row by row."""
    n, height, width, channels = cells.shape
    tiles = cells.reshape(n, height // window, window, width // window, window, channels)
    return tiles.transpose(2, 3).reshape(n, -1, window * window, channels)


def maps_of(windows: Tensor, size: tuple[int, int]) -> Tensor:
    """Return the map of `size` (H, W) from its windows, the inverse of `windows_of`."""
    n, _, cells, channels = windows.shape
    height, width, window = *size, round(cells**0.5)
    tiles = windows.reshape(n, height // window, width // window, window, window, channels)
    return tiles.transpose(2, 3).reshape(n, height, width, channels)


def relative_positions(window: int) -> Tensor:
    """Return the row of the bias for a pair of cells, (window², window²): (2·window − 1)·Δrow + Δcolumn, at least 0."""
    cell = torch.arange(window * window)
    rows, columns = cell // window, cell % window
    row = rows[:, None] - rows[None, :] + window - 1
    column = columns[:, None] - columns[None, :] + window - 1
    return row * (2 * window - 1) + column


def parted_by_the_roll(size: tuple[int, int], window: int, shift: int) -> Tensor:
    """Return which cells of a window were not adjacent before the map was rolled by `shift`: (W, window², window²)."""
    positions = [torch.arange(n) for n in size]
    rows, columns = (
        (p >= n - window).long() + (p >= n - shift).long() for p, n in zip(positions, size, strict=True)
    )  # 0: far from the end, 1: in its last window, 2: rolled over from the beginning
    region = windows_of((3 * rows[:, None] + columns)[None, :, :, None], window)[0, :, :, 0]
    return region[:, :, None] != region[:, None, :]


def stochastic_depth(branch: Tensor, probability: float) -> Tensor:
    """Return the branch, kept or dropped per sample (N) with its expectation preserved (Huang et al., ECCV 2016)."""
    if probability == 0.0:
        return branch
    keep = branch.new_empty([len(branch)] + [1] * (branch.ndim - 1)).bernoulli_(1.0 - probability)
    return branch * keep / (1.0 - probability)
