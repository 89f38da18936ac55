"""Inputs of a model for B frames, and its training targets.

**Conventions.** The *grid frame* is the ego frame at the LiDAR's stamp (x forward, y left, z up), mirrored or rotated
by `grid_from_ego` if training augments it. Points and labels are already in it. Cameras are optical frames (x right, y
down, z forward), pixels u right, v down, the centre of the first pixel (0, 0). Images are undistorted;
`augmented_from_image` contains their resizing, cropping and mirroring. A model sees earlier sweeps, never later ones.
"""

from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import torch
from torch import Tensor

POINT_FEATURES = ("x", "y", "z", "intensity", "age_s")
RADAR_FEATURES = ("x", "y", "z", "rcs_db", "vx_m_s", "vy_m_s", "age_s")
IGNORED = 255  # a voxel that is excluded from losses and metrics

T = TypeVar("T", bound="CameraViews | Points | Batch")


@dataclass(frozen=True, eq=False)
class CameraViews:
    """Images of N cameras, and their poses relative to the ego frame.

    `images` (B, N, 3, H, W) float32, normalised by ImageNet's mean and deviation. `intrinsics` (B, N, 3, 3) of the
    undistorted image before augmentation, `augmented_from_image` (B, N, 3, 3) affine. `ego_from_camera` (B, N, 4, 4)
    from the camera at its exposure to the ego frame at the LiDAR's stamp. `depth_m` (B, N, H, W): the LiDAR's depth
    along z at a pixel of `images`, 0 without a return; only in training.
    """

    images: Tensor
    intrinsics: Tensor
    augmented_from_image: Tensor
    ego_from_camera: Tensor
    depth_m: Tensor | None = None

    def image_from_camera(self) -> Tensor:
        """Camera rays to homogeneous pixels of `images` (B, N, 3, 3), never in half precision."""
        with torch.autocast(self.images.device.type, enabled=False):
            return self.augmented_from_image @ self.intrinsics


@dataclass(frozen=True, eq=False)
class Points:
    """Points of all frames of a batch, one after another, in the grid frame.

    `features` (P, F) float32, x y z in metres first (`POINT_FEATURES` or `RADAR_FEATURES`); `frame` (P,) int64
    ascending is the point's index of B frames. `age_s` is the time from the measurement to the frame, ≥ 0.
    """

    features: Tensor
    frame: Tensor


@dataclass(frozen=True, eq=False)
class Batch:
    """B frames. Parts of absent modalities are None.

    `grid_from_ego` (B, 4, 4) float32. `labels` (B, X, Y, Z) uint8 on the model's lattice: 0 free, 1 T, 2 P, 3 N,
    `IGNORED`; None when predicting.
    """

    tokens: tuple[str, ...]
    grid_from_ego: Tensor
    cameras: CameraViews | None = None
    lidar: Points | None = None
    radar: Points | None = None
    labels: Tensor | None = None

    def __len__(self) -> int:
        return len(self.tokens)

    @property
    def device(self) -> torch.device:
        return self.grid_from_ego.device

    def grid_from_camera(self) -> Tensor:
        """Return (B, N, 4, 4), augmentation included, never in half precision. Raises `ValueError` without cameras."""
        if self.cameras is None:
            raise ValueError("this batch has no cameras")
        with torch.autocast(self.device.type, enabled=False):
            return self.grid_from_ego[:, None] @ self.cameras.ego_from_camera


def moved(value: T, device: torch.device) -> T:
    """Return the value with all tensors on `device`."""
    changes: dict[str, Any] = {}
    for field in fields(value):
        part = getattr(value, field.name)
        if isinstance(part, Tensor):
            changes[field.name] = part.to(device, non_blocking=True)
        elif isinstance(part, CameraViews | Points):
            changes[field.name] = moved(part, device)
    return replace(value, **changes)
