"""Frames of any pictures, taken by cameras that look all round from one place."""

from dataclasses import replace

import torch

from baselines.batch import Batch
from baselines.lattice import VoxelLattice
from tests.baselines.camera_scene import scene_cameras


def frames(images: torch.Tensor, labels: torch.Tensor | None = None) -> Batch:
    """Frames of pictures (B, N, 3, H, W): the first camera looks along x, the others each further to the left."""
    batch, count, _, height, width = images.shape
    empty = VoxelLattice((-1.0, -1.0, -1.0), (2.0, 2.0, 2.0), (1, 1, 1))
    one = scene_cameras(torch.zeros(empty.shape, dtype=torch.uint8), empty, (height, width), count)
    cameras = replace(
        one,
        images=images,
        intrinsics=one.intrinsics.expand(batch, count, 3, 3),
        augmented_from_image=one.augmented_from_image.expand(batch, count, 3, 3),
        ego_from_camera=one.ego_from_camera.expand(batch, count, 4, 4),
        depth_m=None,
    )
    tokens = tuple(f"frame-{index}" for index in range(batch))
    return Batch(tokens, torch.eye(4).expand(batch, 4, 4), cameras, labels=labels)
