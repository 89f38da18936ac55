"""The cascade looks where a child is: in the volume and in the pictures."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.nn import functional

from baselines.batch import Batch, CameraViews
from baselines.layers.image_samples import image_samples, places_in_images
from baselines.models.openocc_cascade import Cascade, children, occupied_cells, volume_samples
from baselines.models.openocc_head import CoarseVolume
from tests.baselines.openocc_frames import LATTICE, lidar_batch, small_row

torch.set_num_threads(1)
FOCAL, WIDTH, HEIGHT = 40.0, 96, 64


def two_cameras() -> Batch:
    """One frame; a camera at the origin looks along x, another a metre above it along y."""
    forward = torch.tensor([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    left = torch.tensor([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 1], [0, 0, 0, 1]])
    intrinsics = torch.tensor([[FOCAL, 0, 47.5], [0, FOCAL, 31.5], [0, 0, 1]])
    return Batch(
        tokens=("frame",),
        grid_from_ego=torch.eye(4)[None],
        cameras=CameraViews(
            images=torch.zeros(1, 2, 3, HEIGHT, WIDTH),
            intrinsics=intrinsics.expand(1, 2, 3, 3),
            augmented_from_image=torch.eye(3).expand(1, 2, 3, 3),
            ego_from_camera=torch.stack([forward, left])[None],
        ),
    )


def points_around(count: int = 500) -> Tensor:
    return (torch.rand(count, 3, generator=torch.Generator().manual_seed(0)) - 0.5) * 8


def pixel_maps(stride: int = 1) -> Tensor:
    """Features (2, 3, h, w) of two pictures: the pixel u, v and 1 at the middle of each cell."""
    v, u = torch.meshgrid(*((torch.arange(n // stride) + 0.5) * stride - 0.5 for n in (HEIGHT, WIDTH)), indexing="ij")
    return torch.stack([u, v, torch.ones_like(u)]).expand(2, -1, -1, -1)


@pytest.mark.parametrize("stride", [1, 8])
def test_a_point_takes_the_features_of_the_pixels_that_see_it(stride: int) -> None:
    batch, points = two_cameras(), points_around()
    samples = image_samples(pixel_maps(stride), points, batch, 0)
    for (x, y, z), (u, v, cameras) in zip(points.tolist(), samples.tolist(), strict=True):
        seen = [(47.5 - FOCAL * y / x, 31.5 - FOCAL * z / x)] if x > 0.001 else []
        seen += [(47.5 + FOCAL * x / y, 31.5 - FOCAL * (z - 1) / y)] if y > 0.001 else []
        margin = stride / 2 - 0.5  # nearer to the edge than the middle of the last cell, samples fade
        inner = [p for p in seen if margin <= p[0] <= 95 - margin and margin <= p[1] <= 63 - margin]
        outer = [p for p in seen if -0.5 <= p[0] <= 95.5 and -0.5 <= p[1] <= 63.5]
        if len(inner) == len(outer):
            assert (u, v, cameras) == pytest.approx(
                (*map(sum, zip(*inner, strict=True)), len(inner)) if inner else (0, 0, 0), abs=1e-3
            )


def test_augmenting_pictures_and_grid_moves_samples_with_them() -> None:
    batch, points, features = two_cameras(), points_around(), torch.randn(2, 4, HEIGHT, WIDTH)
    mirrored_grid = torch.diag(torch.tensor([1.0, -1, 1, 1]))
    mirrored_image = torch.tensor([[-1.0, 0, WIDTH - 1], [0, 1, 0], [0, 0, 1]])
    cameras = replace(batch.cameras, augmented_from_image=mirrored_image.expand(1, 2, 3, 3))
    moved = Batch(("frame",), mirrored_grid[None], cameras)
    ours = image_samples(features.flip(3), points @ mirrored_grid[:3, :3], moved, 0)
    assert torch.allclose(ours, image_samples(features, points, batch, 0), atol=1e-3)


def test_what_no_camera_sees_is_zero_and_has_a_finite_place() -> None:
    behind = torch.tensor([[-2.0, -3, 0], [0, 0, 0], [0, 0, 1]])
    places, is_seen = places_in_images(behind, two_cameras(), 0)
    assert not is_seen.any()
    assert not places.any()
    assert not image_samples(torch.ones(2, 4, 8, 12), behind, two_cameras(), 0).any()
    with pytest.raises(ValueError, match="no cameras"):
        places_in_images(behind, lidar_batch(1), 0)


@pytest.mark.parametrize("ratio", [2, 4])
def test_children_are_sampled_as_the_whole_volume_is_interpolated(ratio: int) -> None:
    volume = torch.randn(5, 4, 6, 3, generator=torch.Generator().manual_seed(0))
    cells = (torch.ones(4, 6, 3) > 0).nonzero()
    voxels = children(cells, ratio)
    whole = functional.interpolate(volume[None], scale_factor=ratio, mode="trilinear", align_corners=False)[0]
    x, y, z = voxels.unbind(dim=1)
    assert len(torch.unique(voxels, dim=0)) == whole[0].numel()
    assert torch.equal(voxels // ratio, cells.repeat_interleave(ratio**3, dim=0))
    assert torch.allclose(volume_samples(volume, voxels, ratio), whole[:, x, y, z].T, atol=1e-5)


def test_at_most_so_many_cells_of_a_frame_are_refined_in_training() -> None:
    logits = torch.randn(4, 8, 8, 4, generator=torch.Generator().manual_seed(0))
    everyone = occupied_cells(logits, None)
    assert torch.equal(everyone, (logits.argmax(dim=0) > 0).nonzero())
    some = occupied_cells(logits, 20)
    assert len(torch.unique(some, dim=0)) == 20
    assert {*map(tuple, some.tolist())} < {*map(tuple, everyone.tolist())}


@pytest.mark.parametrize("occupied", [0.0, 0.1])
def test_the_cascade_refines_children_of_occupied_cells(occupied: float) -> None:
    config = small_row(is_cascade=True)
    cascade = Cascade(config).eval()
    shape = config.coarse_lattice.shape
    logits = torch.zeros(2, 4, *shape)
    logits[:, 0] = 1
    logits[1, 2][torch.rand(shape, generator=torch.Generator().manual_seed(0)) < occupied] = 5
    fine = cascade(CoarseVolume(torch.randn(2, 16, *shape), logits), lidar_batch(2), None)
    refined = torch.zeros(2, *LATTICE.shape, dtype=torch.bool)
    refined[fine.indices.unbind(dim=1)] = True
    expected = functional.interpolate((logits.argmax(dim=1) > 0)[:, None].float(), scale_factor=2)[:, 0] > 0
    assert torch.equal(refined, expected)
    assert fine.logits.shape == (int(expected.sum()), 4)
    fine.logits.sum().backward()
    assert all(parameter.grad is not None for parameter in cascade.parameters())
