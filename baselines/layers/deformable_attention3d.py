"""Multi-scale deformable attention over volumes: each query reads a few learnt places of every level.

**Conventions.** Levels are (X, Y, Z) volumes, flattened in C order and concatenated. Places are fractions of a volume,
with last axis z, y, x, as in `grid_sample`; offsets are in voxels of the level. Volumes are 0 outside.

Source: Zhu et al., Deformable DETR, ICLR 2021, equation 3, in three dimensions: zhangyp15/OccFormer,
necks/multi_scale_deform_attn_3d.py.
"""

from dataclasses import dataclass
from math import tau

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.lattice import Shape


@dataclass(frozen=True)
class DeformableSettings3D:
    """Settings: each of `heads`, of `channels` in all, reads `points` places in each of `levels` volumes."""

    channels: int = 192
    heads: int = 8
    levels: int = 3
    points: int = 4


class DeformableAttention3D(nn.Module):
    """The readings of queries (B, Q, C) at `places` (Q, 3) of `values` (B, ΣXYZ, C): (B, Q, C), without a residual."""

    def __init__(self, settings: DeformableSettings3D) -> None:
        super().__init__()
        self.settings = settings
        channels, samples = settings.channels, settings.heads * settings.levels * settings.points
        self.offsets = nn.Linear(channels, samples * 3)
        self.weights = nn.Linear(channels, samples)
        self.values = nn.Linear(channels, channels)
        self.project = nn.Linear(channels, channels)
        self.reset_parameters()

    def reset_parameters(self) -> None:
        """Initialise offsets as rays from the query, a direction per head, one voxel further with each point."""
        for layer in (self.offsets, self.weights, self.values, self.project):
            nn.init.zeros_(layer.bias)
        for layer in (self.values, self.project):
            nn.init.xavier_uniform_(layer.weight)
        for layer in (self.offsets, self.weights):
            nn.init.zeros_(layer.weight)
        with torch.no_grad():
            self.offsets.bias.copy_(initial_offsets(self.settings).flatten())

    def forward(self, queries: Tensor, places: Tensor, values: Tensor, shapes: tuple[Shape, ...]) -> Tensor:
        s = self.settings
        b, q, _ = queries.shape
        read = self.values(values).reshape(b, values.shape[1], s.heads, -1)
        weights = self.weights(queries).reshape(b, q, s.heads, -1).softmax(dim=-1)
        offsets = self.offsets(queries).reshape(b, q, s.heads, s.levels, s.points, 3)
        size = places.new_tensor(shapes).flip(1)
        at = places[:, None, None, None] + at_least_single(offsets) / size[:, None]
        weights = at_least_single(weights).reshape(b, q, s.heads, s.levels, s.points)
        sampled = sample_volumes(at_least_single(read), shapes, at, weights)  # autocast keeps these in single precision
        projected: Tensor = self.project(sampled.to(queries.dtype))
        return projected


def sample_volumes(values: Tensor, shapes: tuple[Shape, ...], places: Tensor, weights: Tensor) -> Tensor:
    """Return weighted sums of trilinear readings.

    `values` (B, ΣXYZ, H, C), `places` (B, Q, H, L, P, 3), `weights` (B, Q, H, L, P) → (B, Q, H·C).
    """
    b, _, heads, channels = values.shape
    q, points = places.shape[1], places.shape[4]
    total = values.new_zeros(b * heads, channels, q)
    for level, volume in enumerate(torch.split(values, [x * y * z for x, y, z in shapes], dim=1)):
        volume = volume.permute(0, 2, 3, 1).reshape(b * heads, channels, *shapes[level])
        grid = 2.0 * places[:, :, :, level].transpose(1, 2).reshape(b * heads, 1, q, points, 3) - 1.0
        read = functional.grid_sample(volume, grid, mode="bilinear", padding_mode="zeros", align_corners=False)[:, :, 0]
        total = total + (read * weights[:, :, :, level].transpose(1, 2).reshape(b * heads, 1, q, points)).sum(-1)
    return total.reshape(b, heads * channels, q).transpose(1, 2)


def voxel_places(shapes: tuple[Shape, ...], device: torch.device | None = None) -> Tensor:
    """Return the places of the voxels of all levels (ΣXYZ, 3): fractions z, y, x of their volume, float32."""
    places = []
    for shape in shapes:
        axes = [(torch.arange(n, device=device, dtype=torch.float32) + 0.5) / n for n in shape]
        x, y, z = torch.meshgrid(*axes, indexing="ij")
        places.append(torch.stack((z, y, x), dim=-1).flatten(0, 2))
    return torch.cat(places)


def initial_offsets(settings: DeformableSettings3D) -> Tensor:
    """Return offsets (H, L, P, 3) in voxels: the p-th point of a head is p + 1 voxels along the head's direction."""
    angle = torch.arange(settings.heads, dtype=torch.float32) * (tau / settings.heads)
    rays = torch.stack((angle.cos(), angle.sin(), (angle.sin() + angle.cos()) / 2.0), dim=-1)
    rays = rays / rays.abs().amax(dim=-1, keepdim=True)
    steps = torch.arange(1, settings.points + 1, dtype=torch.float32)
    return (rays[:, None, None] * steps[:, None]).expand(-1, settings.levels, -1, -1)


def at_least_single(numbers: Tensor) -> Tensor:
    """Return the numbers in float32, or unchanged if they are more precise."""
    return numbers.to(torch.promote_types(numbers.dtype, torch.float32))
