"""Small frames of cameras in a ring, each looking outwards, that TPVFormer is tried on."""

from math import cos, pi, radians, sin, tan

import torch

from baselines.batch import Batch, CameraViews

HEIGHT_M = 1.0


def ring_of_cameras(count: int) -> torch.Tensor:
    """`ego_from_camera` (count, 4, 4): the first looks along x, the others each further to the left."""
    poses = torch.eye(4).repeat(count, 1, 1)
    for index in range(count):
        yaw = 2 * pi * index / count
        forward, left = (cos(yaw), sin(yaw), 0.0), (-sin(yaw), cos(yaw), 0.0)
        poses[index, :3, 0] = -torch.tensor(left)
        poses[index, :3, 1] = torch.tensor((0.0, 0.0, -1.0))
        poses[index, :3, 2] = torch.tensor(forward)
        poses[index, :3, 3] = torch.tensor((0.2 * forward[0], 0.2 * forward[1], HEIGHT_M))
    return poses


def pinhole(size_px: tuple[int, int], width_deg: float = 75.0) -> torch.Tensor:
    """Intrinsics (3, 3) of a camera that sees `width_deg` from its left to its right edge."""
    height, width = size_px
    focal_px = width / 2 / tan(radians(width_deg) / 2)
    return torch.tensor([[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1]])


def frames(images: torch.Tensor, labels: torch.Tensor | None = None) -> Batch:
    """Frames of pictures (B, N, 3, H, W) that nothing was done to."""
    batch, count = images.shape[:2]
    cameras = CameraViews(
        images,
        pinhole((images.shape[-2], images.shape[-1])).expand(batch, count, 3, 3),
        torch.eye(3).expand(batch, count, 3, 3),
        ring_of_cameras(count).expand(batch, count, 4, 4),
    )
    tokens = tuple(f"frame-{index}" for index in range(batch))
    return Batch(tokens, torch.eye(4).expand(batch, 4, 4), cameras, labels=labels)
