"""A frame with structure, made of nothing: rough ground, boxes of three classes, and what the sensors see of them."""

import torch
from torch import Tensor

from baselines.batch import Batch, CameraViews, Points
from baselines.lattice import VoxelLattice

SMALL = VoxelLattice((-3.2, -3.2, -0.8), (0.2, 0.2, 0.2), (32, 32, 16))
IMAGE = (64, 64)
COLOURS = torch.tensor([[0.0, 0.0, 0.0], [1.0, -1.0, 0.2], [-1.0, 1.0, 0.5], [0.3, 0.3, -1.5]])
BOXES = (
    (4, 8, 6, 5, 1),
    (20, 5, 5, 9, 2),
    (14, 22, 9, 4, 3),
    (25, 24, 4, 8, 3),
    (3, 24, 5, 3, 2),
)  # x y side high class


def boxes_frame(lattice: VoxelLattice = SMALL, frames: int = 1, seed: int = 0) -> Batch:
    """Labels are ground (T in one half, P in the other) and boxes; a tenth of the voxels below ground is ignored."""
    generator = torch.Generator().manual_seed(seed)
    labels = torch.stack([_labels(lattice, frame) for frame in range(frames)])
    lidar = [_lidar(lattice, each, frame, generator) for frame, each in enumerate(labels)]
    radar = [_radar(points, generator) for points in lidar]
    counted = torch.tensor([len(points) for points in lidar])
    frame = torch.arange(frames).repeat_interleave(counted)
    radar_frame = torch.arange(frames).repeat_interleave(torch.tensor([len(points) for points in radar]))
    return Batch(
        tokens=tuple(f"frame-{index}" for index in range(frames)),
        grid_from_ego=torch.eye(4).repeat(frames, 1, 1),
        cameras=_cameras(lattice, labels),
        lidar=Points(torch.cat(lidar), frame),
        radar=Points(torch.cat(radar), radar_frame),
        labels=labels,
    )


def _labels(lattice: VoxelLattice, frame: int) -> Tensor:
    x, y, z = lattice.shape
    ground = 3 + (torch.arange(x)[:, None] // 8 + torch.arange(y) // 12) % 2
    kind = torch.where(torch.arange(x)[:, None] + 0 * torch.arange(y) < x // 2, 1, 2)
    height = torch.arange(z)
    labels = torch.where(height == ground[..., None], kind[..., None], 0)
    labels = torch.where(height < ground[..., None] - 1, 255, labels)
    for left, near, side, high, name in BOXES:
        left, near = (left + 3 * frame) * x // 32, near * y // 32
        labels[left : left + side * x // 32, near : near + side * y // 32, 4 : 4 + high] = name
    return labels.to(torch.uint8)


def _lidar(lattice: VoxelLattice, labels: Tensor, frame: int, generator: torch.Generator) -> Tensor:
    """Points (P, 5): one or two in each occupied voxel that free space touches from above or from a side."""
    is_occupied = (labels > 0) & (labels < 4)
    is_open = torch.zeros_like(is_occupied)
    for axis in range(3):
        is_open |= is_occupied & ~torch.roll(is_occupied, 1, axis)
    places = is_open.nonzero().repeat(2, 1)
    places = places[torch.rand(len(places), generator=generator) < 0.7]
    low, size = torch.tensor(lattice.min_m), torch.tensor(lattice.voxel_m)
    points = low + size * (places + torch.rand(len(places), 3, generator=generator))
    others = torch.rand(len(places), 2, generator=generator)
    return torch.cat([points, others], dim=1)


def _radar(lidar: Tensor, generator: torch.Generator) -> Tensor:
    """A fiftieth of the LiDAR's points, noisier, with a strength and a velocity of nothing."""
    chosen = lidar[:: max(len(lidar) // 50, 1)]
    points = chosen[:, :3] + 0.05 * torch.randn(len(chosen), 3, generator=generator)
    return torch.cat([points, chosen[:, 3:4], torch.zeros(len(chosen), 2), chosen[:, 4:]], dim=1)


def _cameras(lattice: VoxelLattice, labels: Tensor) -> CameraViews:
    """Two cameras at the middle, looking along +x and −x; a pixel has the colour of the nearest occupied voxel."""
    frames = len(labels)
    forward = torch.tensor([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0.9], [0, 0, 0, 1]])
    backward = torch.diag(torch.tensor([-1.0, -1, 1, 1])) @ forward
    ego_from_camera = torch.stack([forward, backward]).repeat(frames, 1, 1, 1)
    height, width = IMAGE
    matrix = torch.tensor([[width / 2, 0, (width - 1) / 2], [0, height / 2, (height - 1) / 2], [0, 0, 1.0]])
    intrinsics = matrix.expand(frames, 2, 3, 3)
    images = torch.stack(
        [torch.stack([_seen(lattice, each, m, matrix) for m in (forward, backward)]) for each in labels]
    )
    return CameraViews(images, intrinsics, torch.eye(3).expand(frames, 2, 3, 3), ego_from_camera)


def _seen(lattice: VoxelLattice, labels: Tensor, ego_from_camera: Tensor, matrix: Tensor) -> Tensor:
    centres = lattice.centres_m()[(labels > 0) & (labels < 4)]
    classes = labels[(labels > 0) & (labels < 4)].long()
    points = (torch.linalg.inv(ego_from_camera) @ torch.cat([centres, torch.ones(len(centres), 1)], dim=1).T)[:3]
    depth, order = points[2].sort(descending=True)  # nearer ones are painted later
    pixel = (matrix @ points[:, order])[:2] / depth.clamp(min=0.1)
    image = torch.zeros(3, *IMAGE)
    for dv in range(-1, 2):
        for du in range(-1, 2):
            place = torch.round(pixel + torch.tensor([[du], [dv]])).long()
            is_in = (depth > 0.1) & (place >= 0).all(0) & (place[0] < IMAGE[1]) & (place[1] < IMAGE[0])
            image[:, place[1, is_in], place[0, is_in]] = COLOURS[classes[order][is_in]].T
    return image
