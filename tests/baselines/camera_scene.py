"""A frame whose truth is known: ground with a track and boxes, pictures and a sweep made by marching along rays."""

from dataclasses import replace

import torch
from torch import Tensor

from baselines.batch import Batch, CameraViews, Points
from baselines.lattice import VoxelLattice

CAMERA_M = (0.3, 0.1, 1.5)
COLOURS = torch.tensor([[0.4, 0.7, 1.0], [0.8, 0.7, 0.3], [0.2, 0.8, 0.2], [0.6, 0.2, 0.7]])  # sky, T, P, N
FORWARD = torch.tensor([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # ego from optical axes
STEP_M = 0.1


def scene_labels(lattice: VoxelLattice) -> Tensor:
    """(X, Y, Z) uint8: ground below z = 0 (P, with a track of T along x), three boxes of N on it."""
    x, y, z = lattice.centres_m().unbind(dim=-1)
    reach, size = lattice.max_m[0], lattice.voxel_m[2]
    labels = torch.zeros(lattice.shape, dtype=torch.uint8)
    labels[(z < 0) & (z > -1.5 * size)] = 2
    labels[(z < 0) & (z > -1.5 * size) & (y.abs() < reach / 5)] = 1
    for centre, half, height in (((0.6, 0.5), 0.15, 2.0), ((-0.5, 0.6), 0.2, 1.0), ((-0.3, -0.6), 0.12, 1.6)):
        is_box = ((x / reach - centre[0]).abs() < half) & ((y / reach - centre[1]).abs() < half)
        labels[is_box & (z > -size) & (z < height)] = 3
    return labels


def hits(origin: Tensor, rays: Tensor, labels: Tensor, lattice: VoxelLattice) -> tuple[Tensor, Tensor]:
    """How many rays' lengths (N,) it is to what rays (N, 3) meet first, 0 where nothing, and its class (N,)."""
    steps = torch.arange(STEP_M, 2.5 * lattice.max_m[0], STEP_M)
    index, is_inside = lattice.indices_of((origin + rays[:, None] * steps[:, None]).reshape(-1, 3))
    classes = torch.where(is_inside, labels[index.unbind(dim=1)], 0).reshape(len(rays), -1)
    first = (classes > 0).int().argmax(dim=1)
    met = classes.gather(1, first[:, None])[:, 0]
    return torch.where(met > 0, steps[first], 0.0), met.long()


def scene_cameras(labels: Tensor, lattice: VoxelLattice, shape: tuple[int, int], count: int) -> CameraViews:
    """Views all round, 110° wide."""
    height, width = shape
    focal = width / 2 / 1.43
    k = torch.tensor([[focal, 0, width / 2 - 0.5], [0, focal, height / 2 - 0.5], [0, 0, 1]])
    v, u = torch.meshgrid(torch.arange(height) + 0.0, torch.arange(width) + 0.0, indexing="ij")
    rays_camera = torch.stack([u, v, torch.ones_like(u)], dim=-1).reshape(-1, 3) @ torch.linalg.inv(k).T
    images, depths, poses = [], [], []
    for number in range(count):
        angle = torch.tensor(2 * torch.pi * number / count)
        pose = torch.eye(4)
        pose[:2, :2] = torch.stack([angle.cos(), -angle.sin(), angle.sin(), angle.cos()]).reshape(2, 2)
        pose[:3, :3] = pose[:3, :3] @ FORWARD
        pose[:3, 3] = torch.tensor(CAMERA_M)
        depth, met = hits(pose[:3, 3], rays_camera @ pose[:3, :3].T, labels, lattice)
        shade = 1 / (1 + depth[:, None] / 10)
        images.append((COLOURS[met] * shade * 2 - 1).T.reshape(3, height, width))
        depths.append(depth.reshape(height, width))
        poses.append(pose)
    still = torch.eye(3).expand(1, count, 3, 3)
    views = (torch.stack(values)[None] for values in (images, poses, depths))
    pictures, extrinsics, depth_m = views
    return CameraViews(pictures, k.expand(1, count, 3, 3), still, extrinsics, depth_m)


def scene_sweep(labels: Tensor, lattice: VoxelLattice) -> Points:
    """One revolution, a ray in each of 24 × 360 directions."""
    elevation, azimuth = torch.meshgrid(torch.linspace(-0.7, 0.3, 24), torch.linspace(0, 6.27, 360), indexing="ij")
    across = elevation.cos()
    rays = torch.stack([across * azimuth.cos(), across * azimuth.sin(), elevation.sin()], dim=-1).reshape(-1, 3)
    origin = torch.tensor(CAMERA_M)
    distance, met = hits(origin, rays, labels, lattice)
    points = (origin + rays * distance[:, None])[met > 0]
    rest = torch.tensor([0.5, 0.0]).expand(len(points), 2)
    return Points(torch.cat([points, rest], dim=1), torch.zeros(len(points), dtype=torch.int64))


def scene_batch(lattice: VoxelLattice, image_shape: tuple[int, int] = (64, 96), cameras: int = 4) -> Batch:
    """One frame of it, with labels."""
    labels = scene_labels(lattice)
    return Batch(
        ("frame",),
        torch.eye(4)[None],
        scene_cameras(labels, lattice, image_shape, cameras),
        scene_sweep(labels, lattice),
        labels=labels[None],
    )


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
