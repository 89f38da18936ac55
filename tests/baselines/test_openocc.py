"""Rows of OpenOccupancy: official sizes, every part is trained, and the cascade looks where a child is."""

from dataclasses import replace
from functools import cache

import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.batch import IGNORED, Batch, CameraViews
from baselines.lattice import VoxelLattice
from baselines.layers.image_samples import image_samples, places_in_images
from baselines.layers.lifting import lift
from baselines.models.openocc import CameraVoxelEncoder, OpenOcc, by_own_value, lattice_of_points
from baselines.models.openocc_cascade import Cascade, children, occupied_cells, volume_samples
from baselines.models.openocc_config import Modality, OpenOccConfig, official_row
from baselines.models.openocc_head import CoarseVolume
from tests.baselines.camera_scene import scene_batch, scene_labels
from tests.baselines.openocc_frames import LATTICE, lidar_batch, small_row, without_labels

torch.set_num_threads(1)
ROWS = pytest.mark.parametrize("is_cascade", [False, True])


def row(*, is_cascade: bool = False) -> OpenOcc:
    torch.manual_seed(0)
    return OpenOcc(small_row(is_cascade=is_cascade))


def parameters(module: nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


def test_lidar_rows_have_the_official_numbers_of_parameters() -> None:
    with torch.device("meta"):
        plain = OpenOcc(replace(official_row("L", is_cascade=False), coarse_ratio=4))
        cascaded = OpenOcc(replace(official_row("L", is_cascade=True), coarse_ratio=4))
    assert parameters(plain) == 65_627_296
    assert parameters(cascaded) - parameters(plain) == (128 * 64 + 64) + 2 * 64 + (64 * 4 + 4)


@ROWS
def test_every_parameter_gets_a_gradient_of_the_sum_of_losses(is_cascade: bool) -> None:
    model, batch = row(is_cascade=is_cascade), lidar_batch()
    terms = model.losses(model(batch), batch)
    torch.stack(list(terms.values())).sum().backward()
    assert len(terms) == (8 if is_cascade else 4)
    assert all(term.dtype == torch.float32 and term.shape == () for term in terms.values())
    without = [
        name
        for name, parameter in model.named_parameters()
        if parameter.grad is None or not parameter.grad.any() or not parameter.grad.isfinite().all()
    ]
    assert without == []


@ROWS
def test_a_prediction_needs_no_labels_and_is_on_the_lattice(is_cascade: bool) -> None:
    model, batch = row(is_cascade=is_cascade).eval(), without_labels(lidar_batch())
    with torch.no_grad():
        logits = model.logits(model(batch), batch)
    assert logits.shape == (2, 4, *LATTICE.shape)
    assert logits.dtype == torch.float32
    assert logits.isfinite().all()


def test_bfloat16_says_nearly_the_same() -> None:
    model, batch = row(is_cascade=True), lidar_batch(1)
    exact = model(batch)
    with torch.autocast("cpu", torch.bfloat16):
        outputs = model(batch)
        terms = model.losses(outputs, batch)
    assert (outputs.coarse - exact.coarse).abs().mean() < 0.1 * exact.coarse.std()
    for name, term in model.losses(exact, batch).items():
        assert terms[name].dtype == torch.float32
        assert terms[name].item() == pytest.approx(term.item(), rel=0.05)


def test_a_frame_is_predicted_the_same_alone_and_in_a_batch() -> None:
    model, both, alone = row(is_cascade=True).eval(), lidar_batch(2), lidar_batch(1)
    with torch.no_grad():
        expected = model.logits(model(alone), alone)[0]
        assert torch.allclose(model.logits(model(both), both)[0], expected, atol=1e-4)


def test_checkpointed_gradients_are_the_same() -> None:
    gradients: list[list[Tensor]] = []
    for checkpoints in (False, True):
        torch.manual_seed(0)
        model, batch = OpenOcc(replace(small_row(), checkpoint_gradients=checkpoints)), lidar_batch(1)
        torch.stack(list(model.losses(model(batch), batch).values())).sum().backward()
        gradients.append([parameter.grad for parameter in model.parameters() if parameter.grad is not None])
    assert len(gradients[0]) == len(gradients[1])
    assert all(torch.allclose(a, b, atol=1e-6) for a, b in zip(*gradients, strict=True))


def test_a_term_keeps_its_value_and_its_gradient_is_divided_by_it() -> None:
    x = torch.tensor(3.0, requires_grad=True)
    term = by_own_value(x**2)
    term.backward()
    assert term.item() == 9
    assert x.grad.item() == pytest.approx(6 / 9)


def test_supervised_voxels_are_those_that_are_predicted() -> None:
    model, batch = row(), lidar_batch()
    model.config = replace(model.config, supervises_voxels=True)
    outputs = model(batch)
    scores, labels = model.supervised(outputs.coarse, batch.labels)
    assert torch.equal(scores, model.logits(outputs, batch))
    assert torch.equal(labels, batch.labels)


def test_ignored_labels_leave_losses_finite() -> None:
    model, batch = row(is_cascade=True), lidar_batch()
    unseen = replace(batch, labels=torch.full_like(batch.labels, IGNORED))
    terms = model.losses(model(batch), unseen)
    assert all(term.item() == 0 for term in terms.values())


def test_small_voxels_divide_coarse_cells() -> None:
    assert lattice_of_points(small_row()).shape == (64, 64, 32)
    with pytest.raises(ValueError, match=r"not whole numbers of voxels of 0\.15 m"):
        lattice_of_points(replace(small_row(), lidar_voxel_m=0.15))
    with pytest.raises(ValueError, match="4 or 8 times coarser, not 2 times"):
        OpenOcc(replace(small_row(), lidar_voxel_m=0.2))


CAMERA_LATTICE = VoxelLattice((-6.4, -6.4, -1.2), (0.4, 0.4, 0.4), (32, 32, 8))
SMALL_CAMERAS = OpenOccConfig(
    lattice=CAMERA_LATTICE,
    volume_channels=8,
    lidar_voxel_m=0.2,
    sparse_channels=4,
    image_shape=(64, 96),
    resnet_depth=14,
    resnet_width=4,
    neck_channels=(4, 4, 4, 4),
    depth_range_m=(0.5, 12.5),
    residual_channels=(8, 8, 16, 16),
    residual_blocks=(1, 1, 1, 1),
    pyramid_channels=16,
    fine_channels=16,
    refined_cells=100,
)
CAMERA_ROWS: tuple[tuple[Modality, bool], ...] = (("C", True), ("C+L", True))


@cache
def frame() -> Batch:
    return scene_batch(CAMERA_LATTICE)


def camera_row(modality: Modality, is_cascade: bool) -> OpenOcc:
    torch.manual_seed(0)
    return OpenOcc(replace(SMALL_CAMERAS, modality=modality, is_cascade=is_cascade))


@pytest.mark.parametrize(
    ("modality", "is_cascade", "millions", "parameters"),
    [
        ("C", False, 97.3, 97_325_640),
        ("C", True, 116.1, 116_113_740),
        ("C+L", False, 123.4, 123_380_056),
        ("C+L", True, 123.5, 123_467_100),
    ],
)
def test_a_row_has_its_official_number_of_parameters(
    modality: Modality, is_cascade: bool, millions: float, parameters: int
) -> None:
    with torch.device("meta"):
        model = OpenOcc(replace(official_row(modality, is_cascade), coarse_ratio=4))
    assert sum(parameter.numel() for parameter in model.parameters()) == parameters
    assert round(parameters / 1e6, 1) == millions


@pytest.mark.parametrize(("modality", "is_cascade"), CAMERA_ROWS)
def test_every_parameter_gets_a_gradient_from_the_sum_of_losses(modality: Modality, is_cascade: bool) -> None:
    model = camera_row(modality, is_cascade).train()
    losses = model.losses(model(frame()), frame())
    assert all(torch.isfinite(term) and term.dtype == torch.float32 for term in losses.values())
    assert "depth" in losses
    sum(losses.values(), torch.zeros(())).backward()
    assert [name for name, parameter in model.named_parameters() if parameter.grad is None] == []
    assert all(torch.isfinite(parameter.grad).all() for parameter in model.parameters() if parameter.grad is not None)


@pytest.mark.parametrize("modality", ["C", "C+L"])
def test_a_row_under_bfloat16_answers_what_it_answers_in_float32(modality: Modality) -> None:
    model = camera_row(modality, is_cascade=False).eval()
    with torch.no_grad():
        exact = model.logits(model(frame()), frame())
        with torch.autocast("cpu", torch.bfloat16):
            near = model.logits(model(frame()), frame())
    assert (near - exact).norm() < 0.03 * exact.norm()


def test_checkpointed_lifting_has_the_same_gradients() -> None:
    gradients = []
    for is_checkpointed in (False, True):
        torch.manual_seed(0)
        config = replace(SMALL_CAMERAS, depth_dropout=0.0, checkpoint_gradients=is_checkpointed)
        encoder = CameraVoxelEncoder(config).train()
        encoder(frame()).voxels.square().sum().backward()
        gradients.append(encoder.backbone.conv1.weight.grad)
    torch.testing.assert_close(gradients[0], gradients[1])


def test_features_land_where_depth_says_that_surfaces_are() -> None:
    """With the true depth as its distribution, lifted weight is in occupied voxels and their neighbours."""
    encoder = CameraVoxelEncoder(SMALL_CAMERAS)
    cameras = frame().cameras
    frustum, depth = encoder.frustum, cameras.depth_m[:, :, 8::16, 8::16]
    nearest = ((depth - frustum.min_m) / frustum.step_m).round().long().clamp(0, frustum.bins - 1)
    logits = torch.full((1, 4, frustum.bins, *depth.shape[2:]), -100.0).scatter(2, nearest[:, :, None], 0.0)
    context = (depth > 0).float()[:, :, None]
    points = frustum.points_of(frame(), (4, 6))
    volume = lift(logits, context, points, CAMERA_LATTICE)[0]
    labels = scene_labels(CAMERA_LATTICE)
    near = torch.nn.functional.max_pool3d((labels > 0).float()[None, None], 3, 1, 1)
    assert volume.sum() > 20
    assert (volume * near).sum() > 0.9 * volume.sum()
    assert (volume * (near == 0)).sum() < (volume * (labels > 0)).sum()


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
