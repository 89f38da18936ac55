"""C and M rows of OpenOccupancy: official sizes, what they answer, and that every part of them is trained."""

from dataclasses import replace
from functools import cache

import pytest
import torch

from baselines.batch import Batch
from baselines.lattice import VoxelLattice
from baselines.layers.lifting import lift
from baselines.models.openocc import OpenOcc
from baselines.models.openocc_cameras import CameraVoxelEncoder
from baselines.models.openocc_config import Modality, OpenOccConfig, official_row
from tests.baselines.camera_scene import scene_batch, scene_labels

LATTICE = VoxelLattice((-6.4, -6.4, -1.2), (0.4, 0.4, 0.4), (32, 32, 8))
SMALL = OpenOccConfig(
    lattice=LATTICE,
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
ROWS: tuple[tuple[Modality, bool], ...] = (("C", False), ("C", True), ("C+L", False), ("C+L", True))


@cache
def frame() -> Batch:
    return scene_batch(LATTICE)


def small_row(modality: Modality, is_cascade: bool) -> OpenOcc:
    torch.manual_seed(0)
    return OpenOcc(replace(SMALL, modality=modality, is_cascade=is_cascade))


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


@pytest.mark.parametrize(("modality", "is_cascade"), ROWS)
def test_every_parameter_gets_a_gradient_from_the_sum_of_losses(modality: Modality, is_cascade: bool) -> None:
    model = small_row(modality, is_cascade).train()
    losses = model.losses(model(frame()), frame())
    assert all(torch.isfinite(term) and term.dtype == torch.float32 for term in losses.values())
    assert "depth" in losses
    sum(losses.values(), torch.zeros(())).backward()
    assert [name for name, parameter in model.named_parameters() if parameter.grad is None] == []
    assert all(torch.isfinite(parameter.grad).all() for parameter in model.parameters() if parameter.grad is not None)


@pytest.mark.parametrize("modality", ["C", "C+L"])
def test_a_row_under_bfloat16_answers_what_it_answers_in_float32(modality: Modality) -> None:
    model = small_row(modality, is_cascade=False).eval()
    with torch.no_grad():
        exact = model.logits(model(frame()), frame())
        with torch.autocast("cpu", torch.bfloat16):
            near = model.logits(model(frame()), frame())
    assert (near - exact).norm() < 0.03 * exact.norm()


def test_checkpointed_lifting_has_the_same_gradients() -> None:
    gradients = []
    for is_checkpointed in (False, True):
        torch.manual_seed(0)
        config = replace(SMALL, depth_dropout=0.0, checkpoint_gradients=is_checkpointed)
        encoder = CameraVoxelEncoder(config).train()
        encoder(frame()).voxels.square().sum().backward()
        gradients.append(encoder.backbone.conv1.weight.grad)
    torch.testing.assert_close(gradients[0], gradients[1])


def test_features_land_where_depth_says_that_surfaces_are() -> None:
    """With the true depth as its distribution, lifted weight is in occupied voxels and their neighbours."""
    encoder = CameraVoxelEncoder(SMALL)
    cameras = frame().cameras
    frustum, depth = encoder.frustum, cameras.depth_m[:, :, 8::16, 8::16]
    nearest = ((depth - frustum.min_m) / frustum.step_m).round().long().clamp(0, frustum.bins - 1)
    logits = torch.full((1, 4, frustum.bins, *depth.shape[2:]), -100.0).scatter(2, nearest[:, :, None], 0.0)
    context = (depth > 0).float()[:, :, None]
    points = frustum.points_of(frame(), (4, 6))
    volume = lift(logits, context, points, LATTICE)[0]
    labels = scene_labels(LATTICE)
    near = torch.nn.functional.max_pool3d((labels > 0).float()[None, None], 3, 1, 1)
    assert volume.sum() > 20
    assert (volume * near).sum() > 0.9 * volume.sum()
    assert (volume * (near == 0)).sum() < (volume * (labels > 0)).sum()
