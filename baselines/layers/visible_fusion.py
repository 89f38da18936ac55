"""OpenOccupancy's fusion of two volumes: a gate per voxel mixes both.

Source: Wang et al., OpenOccupancy (ICCV 2023), "adaptive fusion"; `occupancy/fuser/visfuse.py`.
"""

import torch
from torch import Tensor, nn

GATE_CHANNELS = 16


class VisibleFusion(nn.Module):
    """Two volumes (B, C, X, Y, Z) to one: gate · camera + (1 − gate) · lidar, after a 7³ convolution of each."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.camera = normalised_convolution(channels, channels, 7)
        self.lidar = normalised_convolution(channels, channels, 7)
        self.gate = nn.Sequential(
            normalised_convolution(2 * channels, GATE_CHANNELS, 3),
            nn.Conv3d(GATE_CHANNELS, 1, 1, bias=False),
            nn.Sigmoid(),
        )

    def forward(self, camera: Tensor, lidar: Tensor) -> Tensor:
        camera, lidar = self.camera(camera), self.lidar(lidar)
        gate: Tensor = self.gate(torch.cat([camera, lidar], dim=1))
        return gate * camera + (1 - gate) * lidar


def normalised_convolution(channels_in: int, channels_out: int, size: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv3d(channels_in, channels_out, size, padding=size // 2, bias=False),
        nn.BatchNorm3d(channels_out, eps=1e-3, momentum=0.01),
        nn.ReLU(inplace=True),
    )
