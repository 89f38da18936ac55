"""Features of images at the pixels that see given points."""

import torch
from torch import Tensor
from torch.nn import functional

from baselines.batch import Batch

NEAREST_M = 1e-3  # a point nearer to the camera's plane, or behind it, is not seen


def image_samples(features: Tensor, points_grid: Tensor, batch: Batch, frame: int) -> Tensor:
    """Return bilinear samples (N, C) of a frame's features (K, C, H', W') at points (N, 3), summed over cameras that
    see them.

    0 for points outside all images. The features cover the whole images, whatever their stride.
    """
    places, is_seen = places_in_images(points_grid, batch, frame)
    samples = functional.grid_sample(features.float(), places[:, None], mode="bilinear", align_corners=False)
    return (samples[:, :, 0] * is_seen[:, None]).sum(dim=0).T


def places_in_images(points_grid: Tensor, batch: Batch, frame: int) -> tuple[Tensor, Tensor]:
    """Return the image positions (K, N, 2) of points (N, 3), −1 … 1 from edge to edge, and whether K cameras see them
    (K, N).

    Positions of invisible points are 0. Raises `ValueError` without cameras.
    """
    if batch.cameras is None:
        raise ValueError("this batch has no cameras")
    with torch.autocast(points_grid.device.type, enabled=False):
        camera_from_grid = torch.linalg.inv(batch.grid_from_camera()[frame])
        image_from_camera = batch.cameras.image_from_camera()[frame]
        rays = points_grid @ camera_from_grid[:, :3, :3].mT + camera_from_grid[:, None, :3, 3]
        homogeneous = rays @ image_from_camera.mT
        depth_m = rays[..., 2:]
        pixels = homogeneous[..., :2] / depth_m.clamp(min=NEAREST_M)
        size = pixels.new_tensor(batch.cameras.images.shape[:-3:-1])  # width, height
        places = (pixels + 0.5) / size * 2 - 1  # pixel 0 is half a pixel from the edge
        is_seen = (depth_m[..., 0] > NEAREST_M) & (places.abs() < 1).all(dim=-1)
        return torch.where(is_seen[..., None], places, 0.0), is_seen
