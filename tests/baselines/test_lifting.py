"""Lifting against a slow loop, what moves with the world, and losses of depth in closed form."""

from itertools import pairwise, product
from math import erf, log, sqrt

import pytest
import torch
from torch import Tensor

from baselines.batch import Batch, CameraViews
from baselines.lattice import VoxelLattice
from baselines.layers.depth_network import DepthNetwork, DepthNetworkConfig, camera_vectors
from baselines.layers.lifting import Frustum, lift, splat
from baselines.layers.visible_fusion import VisibleFusion
from baselines.losses.depth import depth_cross_entropy, depth_divergence, nearest_depth

LATTICE = VoxelLattice((-8.0, -8.0, -2.0), (1.0, 1.0, 1.0), (16, 16, 4))
FRUSTUM = Frustum(1.0, 9.0, 1.0, stride=4)
SHAPE = (3, 4)  # of the feature map
FORWARD = torch.tensor([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]], dtype=torch.float64)  # ego from optical axes


def turned(angle: float) -> Tensor:
    """About z, (4, 4) float64."""
    c, s = torch.cos(torch.tensor(angle, dtype=torch.float64)), torch.sin(torch.tensor(angle, dtype=torch.float64))
    turn = torch.eye(4, dtype=torch.float64)
    turn[0, 0], turn[0, 1], turn[1, 0], turn[1, 1] = c, -s, s, c
    return turn


def rig(frames: int, cameras: int) -> tuple[Tensor, Tensor]:
    """Image from camera (B, N, 3, 3), scaled and mirrored as in training, and ego from camera (B, N, 4, 4)."""
    torch.manual_seed(0)
    intrinsics = torch.tensor([[9.0, 0, 8], [0, 10, 6], [0, 0, 1]], dtype=torch.float64).expand(frames, cameras, 3, 3)
    augmentation = torch.tensor([[-0.9, 0.05, 15], [0.02, 1.1, -1], [0, 0, 1]], dtype=torch.float64)
    poses = torch.stack([turned(0.3 + number) for number in range(frames * cameras)])
    poses[:, :3, :3] = poses[:, :3, :3] @ FORWARD
    poses[:, :3, 3] = torch.rand(frames * cameras, 3, dtype=torch.float64)
    return augmentation @ intrinsics, poses.reshape(frames, cameras, 4, 4)


def maps(frames: int, cameras: int) -> tuple[Tensor, Tensor]:
    """Probabilities of depth, and context of 5 channels."""
    depth = torch.randn(frames, cameras, FRUSTUM.bins, *SHAPE, dtype=torch.float64).softmax(dim=2)
    return depth, torch.randn(frames, cameras, 5, *SHAPE, dtype=torch.float64)


def slowly_splat(depth: Tensor, context: Tensor, image_from_camera: Tensor, grid_from_camera: Tensor) -> Tensor:
    """Every bin of every cell by itself: a pixel, its ray, a point, a voxel."""
    volume = torch.zeros(len(depth), context.shape[2], *LATTICE.shape, dtype=torch.float64)
    for b, n, d, row, column in product(*(range(size) for size in depth.shape)):
        pixel = torch.tensor([4 * column + 1.5, 4 * row + 1.5, 1], dtype=torch.float64)
        point_camera = torch.linalg.solve(image_from_camera[b, n], pixel) * (1.0 + d)
        point = grid_from_camera[b, n] @ torch.cat([point_camera, point_camera.new_ones(1)])
        place = [int((p - low) // size) for p, low, size in zip(point, LATTICE.min_m, LATTICE.voxel_m, strict=False)]
        if all(0 <= i < size for i, size in zip(place, LATTICE.shape, strict=True)):
            volume[b, :, place[0], place[1], place[2]] += depth[b, n, d, row, column] * context[b, n, :, row, column]
    return volume


def views(frames: int = 2, cameras: int = 3) -> Batch:
    image_from_camera, poses = (value.float() for value in rig(frames, cameras))
    identity = torch.eye(3).expand(frames, cameras, 3, 3)
    seen = CameraViews(torch.zeros(frames, cameras, 3, 12, 16), image_from_camera, identity, poses)
    return Batch(("a", "b")[:frames], torch.eye(4).expand(frames, 4, 4), cameras=seen)


def test_splatting_is_what_one_bin_after_another_gives() -> None:
    image_from_camera, poses = rig(2, 3)
    depth, context = maps(2, 3)
    volume = splat(depth, context, FRUSTUM.points(image_from_camera, poses, SHAPE), LATTICE)
    expected = slowly_splat(depth, context, image_from_camera, poses)
    assert expected.abs().sum() > 10
    torch.testing.assert_close(volume, expected, rtol=0, atol=1e-12)


def test_points_that_are_not_numbers_count_nowhere() -> None:
    depth, context = maps(1, 1)
    assert splat(depth, context, torch.full((1, 1, 8, *SHAPE, 3), torch.nan), LATTICE).abs().sum() == 0


def test_lifting_under_autocast_is_done_in_float32() -> None:
    logits, context = torch.randn(1, 2, 8, *SHAPE), torch.randn(1, 2, 5, *SHAPE)
    points = FRUSTUM.points(*(value.float() for value in rig(1, 2)), SHAPE)
    exact = lift(logits, context, points, LATTICE)
    with torch.autocast("cpu", torch.bfloat16):
        inside = lift(logits, context, points, LATTICE)
    assert all(torch.equal(a, b) for a, b in zip(exact, inside, strict=True))


def test_every_parameter_of_the_depth_network_gets_a_gradient_and_cameras_matter() -> None:
    torch.manual_seed(0)
    batch = views()
    model = DepthNetwork(DepthNetworkConfig(8, 8, 5, FRUSTUM.bins, dropout=0.0))
    features, vectors = torch.rand(6, 8, 6, 6), camera_vectors(batch).flatten(0, 1)
    depth, context = model(features, vectors)
    assert (depth.shape, context.shape) == ((6, 8, 6, 6), (6, 5, 6, 6))
    (depth.square().sum() + context.sum()).backward()
    assert all(parameter.grad is not None for parameter in model.parameters())
    assert (model(features, vectors.roll(1, 0))[0] - depth).abs().max() > 1e-3


def test_a_cameras_vector_holds_every_number_of_its_geometry_once() -> None:
    batch = views()
    vectors = camera_vectors(batch)
    assert vectors.shape == (2, 3, 27)
    k = batch.cameras.intrinsics[1, 2]
    assert (1e3 * vectors[1, 2, :4]).tolist() == pytest.approx(k[[0, 1, 0, 1], [0, 1, 2, 2]].tolist())
    assert vectors[1, 2, 4:15].tolist() == [1, 0, 0, 0, 1, 0, 1, 0, 0, 1, 1]
    assert torch.equal(vectors[1, 2, 15:].reshape(3, 4), batch.cameras.ego_from_camera[1, 2, :3])


def test_a_cells_depth_is_the_nearest_of_its_pixels() -> None:
    depth = torch.zeros(1, 1, 4, 8)
    depth[0, 0, 1, 2], depth[0, 0, 3, 3], depth[0, 0, 0, 0] = 7.0, 5.0, 9.0
    assert nearest_depth(depth, 4).tolist() == [[[[5.0, 0.0]]]]


def test_the_divergence_is_that_of_a_normal_distribution_and_least_where_depth_is_right() -> None:
    frustum = Frustum(2.0, 8.0, 0.5, stride=4)
    depth = torch.zeros(1, 1, 4, 4)
    depth[0, 0, 2, 1] = 4.2
    cdf = [0.5 * (1 + erf((2.0 + 0.5 * i - 0.25 - 4.2) / (0.5 * sqrt(2)))) for i in range(13)]
    target = torch.tensor([b - a for a, b in pairwise(cdf)])
    uniform = torch.full((1, 1, 12, 1, 1), 1 / 12)
    expected = sum(float(t) * (log(float(t)) - log(1 / 12 + 1e-4)) for t in target if t > 0)
    assert float(depth_divergence(uniform, depth, frustum)) == pytest.approx(expected, abs=1e-5)
    right = target.view(1, 1, 12, 1, 1)
    assert abs(float(depth_divergence(right, depth, frustum))) < 2e-3
    assert int(right.argmax()) == 4  # the bin about 4.0 m, which 4.2 m is nearest to
    assert depth_divergence(right.roll(1, 2), depth, frustum) > 0.3


def test_the_cross_entropy_is_nothing_at_the_nearest_bin() -> None:
    frustum = Frustum(2.0, 8.0, 0.5, stride=4)
    depth = torch.zeros(1, 1, 4, 4)
    depth[0, 0, 0, 0] = 4.2
    sure = torch.zeros(1, 1, 12, 1, 1)
    sure[:, :, 4] = 1.0
    assert depth_cross_entropy(sure, depth, frustum) == 0
    uniform = torch.full((1, 1, 12, 1, 1), 1 / 12)
    expected = -log(1 / 12) - 11 * log(11 / 12)
    assert float(depth_cross_entropy(uniform, depth, frustum)) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("loss", [depth_divergence, depth_cross_entropy])
def test_pictures_without_depth_cost_nothing_and_cells_without_it_count_nothing(loss: object) -> None:
    frustum = Frustum(2.0, 8.0, 0.5, stride=4)
    logits = torch.randn(1, 1, 12, 1, 2, requires_grad=True)
    depth = torch.zeros(1, 1, 4, 8)
    nothing = loss(logits.softmax(dim=2), depth, frustum)  # type: ignore[operator]
    nothing.backward()
    assert nothing == 0
    assert logits.grad.abs().sum() == 0
    depth[0, 0, 0, 5] = 3.0
    depth[0, 0, 0, 0] = 100.0
    both = loss(logits.softmax(dim=2), depth, frustum)  # type: ignore[operator]
    alone = loss(logits[..., 1:].softmax(dim=2), depth[..., 4:], frustum)  # type: ignore[operator]
    torch.testing.assert_close(both, alone)


def test_fusion_lies_between_its_two_volumes_and_has_its_official_number_of_parameters() -> None:
    with torch.device("meta"):
        official = VisibleFusion(80)
    assert sum(p.numel() for p in official.parameters()) == 2 * (80 * 80 * 343 + 160) + 160 * 16 * 27 + 32 + 16
    torch.manual_seed(0)
    fusion = VisibleFusion(3)
    camera, lidar = torch.rand(2, 3, 6, 5, 4), torch.rand(2, 3, 6, 5, 4)
    fused, (a, b) = fusion(camera, lidar), (fusion.camera(camera), fusion.lidar(lidar))
    assert (fused <= torch.maximum(a, b) + 1e-5).all()
    assert (fused >= torch.minimum(a, b) - 1e-5).all()
    fused.square().sum().backward()
    assert all(parameter.grad is not None for parameter in fusion.parameters())
