"""OccFusion: near the official sizes, all of it learns, and each layer is a slow and obvious one."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor, nn

from baselines.batch import CameraViews, Points
from baselines.lattice import VoxelLattice
from baselines.layers.camera_projection import project_features
from baselines.layers.efficient_vit import EfficientViTBlock, relu_attention
from baselines.layers.voxel_features import PointVolumes, VoxelFeatureEncoder
from baselines.losses.voxels import cross_entropy, focal_loss
from baselines.models.occfusion import OccFusion
from baselines.models.occfusion_config import OccFusionConfig
from tests.baselines.boxes_frame import boxes_frame

TINY = OccFusionConfig(
    modality="C+L+R",
    lattice=VoxelLattice((-3.2, -3.2, -0.8), (0.4, 0.4, 0.4), (16, 16, 8)),
    resnet_depth=14,
    resnet_width=4,
    deformable_stages=(False, False, False, True),
    frozen_stages=-1,
    norm_eval=False,
    pyramid_channels=8,
    level_channels=(4, 4, 8, 8),
    point_widths=(4, 8),
    head_channels=4,
    atrous_rates=(1, 2),
)
OFFICIAL = {"C": 67_037_673, "C+R": 92_566_111, "C+L": 126_462_669}


def parameters(module: nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


@pytest.mark.parametrize("modality", ["C", "C+R", "C+L"])
def test_the_full_size_is_the_official_one_to_a_hundredth_and_a_half(modality: str) -> None:
    with torch.device("meta"):
        model = OccFusion(OccFusionConfig(modality=modality))  # type: ignore[arg-type]
    assert parameters(model) == pytest.approx(OFFICIAL[modality], rel=0.015)


@pytest.mark.parametrize("modality", ["C", "C+R", "C+L", "C+L+R"])
def test_it_answers_on_its_lattice_and_on_three_coarser_ones(modality: str) -> None:
    model = OccFusion(replace(TINY, modality=modality))  # type: ignore[arg-type]
    batch = boxes_frame(TINY.lattice, frames=2)
    outputs = model.eval()(batch)
    assert [tuple(each.shape) for each in outputs] == [
        (2, 4, 16, 16, 8), (2, 4, 8, 8, 4), (2, 4, 4, 4, 2), (2, 4, 2, 2, 1),
    ]  # fmt: skip
    assert model.logits(outputs, batch).dtype == torch.float32
    assert set(model.losses(outputs, batch)) == {"focal", "geometric", "semantic", "lovasz"}


@pytest.mark.parametrize("checkpoints", [False, True])
def test_every_parameter_gets_a_gradient_from_the_sum_of_the_losses(*, checkpoints: bool) -> None:
    torch.manual_seed(0)
    model = OccFusion(replace(TINY, checkpoint_gradients=checkpoints))
    batch = boxes_frame(TINY.lattice, frames=2)
    torch.stack(list(model.losses(model(batch), batch).values())).sum().backward()
    without = [name for name, parameter in model.named_parameters() if parameter.grad is None]
    assert without == []
    assert all(bool(parameter.grad.isfinite().all()) for parameter in model.parameters() if parameter.grad is not None)


def test_half_precision_answers_nearly_the_same() -> None:
    torch.manual_seed(0)
    model = OccFusion(TINY).eval()
    batch = boxes_frame(TINY.lattice)
    with torch.no_grad():
        whole = model.logits(model(batch), batch)
        with torch.autocast("cpu", torch.bfloat16):
            half = model.logits(model(batch), batch)
    assert (whole - half).abs().max() < 0.05 * whole.abs().max()


def test_frames_of_a_batch_do_not_see_each_other() -> None:
    torch.manual_seed(0)
    model = OccFusion(TINY).eval()
    with torch.no_grad():
        both = model(boxes_frame(TINY.lattice, frames=2))[0]
        one = model(boxes_frame(TINY.lattice, frames=1))[0]
    torch.testing.assert_close(both[:1], one, atol=1e-4, rtol=1e-4)


LATTICE = VoxelLattice((-1.6, -1.6, -0.4), (0.4, 0.4, 0.4), (8, 8, 4))


def projected_slowly(features: Tensor, views: CameraViews, grid_from_camera: Tensor) -> tuple[Tensor, Tensor]:
    """Of one frame: a loop over voxels and cameras, doubles, no matrices put together before."""
    height, width = views.images.shape[-2:]
    rows, columns = features.shape[-2:]
    volume, bev = torch.zeros(features.shape[2], *LATTICE.shape), torch.zeros(features.shape[2], *LATTICE.shape[:2])
    for x in range(LATTICE.shape[0]):
        for y in range(LATTICE.shape[1]):
            in_column: list[Tensor] = []
            for z in range(LATTICE.shape[2]):
                seen: list[Tensor] = []
                for camera in range(features.shape[1]):
                    centre = torch.cat([LATTICE.centres_m()[x, y, z], torch.ones(1)]).double()
                    ray = (torch.linalg.inv(grid_from_camera[0, camera].double()) @ centre)[:3]
                    u, v, _ = views.intrinsics[0, camera].double() @ ray / ray[2]
                    u, v, _ = views.augmented_from_image[0, camera].double() @ torch.stack(
                        [u, v, torch.ones(()).double()]
                    )
                    if ray[2] > 0.1 and -0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5:
                        row, column = int((v + 0.5) * rows / height), int((u + 0.5) * columns / width)
                        seen.append(features[0, camera, :, row, column])
                if seen:
                    volume[:, x, y, z] = torch.stack(seen).mean(dim=0)
                in_column += seen
            if in_column:
                bev[:, x, y] = torch.stack(in_column).mean(dim=0)
    return volume, bev


@pytest.mark.parametrize("cells", [(8, 8), (5, 7)])
def test_projection_is_the_mean_of_the_cells_that_each_centre_falls_in(cells: tuple[int, int]) -> None:
    batch = boxes_frame()
    augmented = torch.tensor([[0.9, 0, 3.3], [0, 1.1, -2.2], [0, 0, 1]]).expand(1, 2, 3, 3)
    turned = torch.tensor([[0.0, -1, 0, 0.3], [1, 0, 0, 0.1], [0, 0, 1, 0], [0, 0, 0, 1]])[None]
    batch = replace(batch, grid_from_ego=turned, cameras=replace(batch.cameras, augmented_from_image=augmented))
    features = torch.randn(1, 2, 3, *cells)
    volume, bev = project_features(features, batch.cameras, batch.grid_from_camera(), LATTICE)
    slow_volume, slow_bev = projected_slowly(features, batch.cameras, batch.grid_from_camera())
    assert (slow_volume != 0).any()
    torch.testing.assert_close(volume[0], slow_volume)
    torch.testing.assert_close(bev[0], slow_bev)


def test_what_no_camera_sees_is_nothing_and_has_no_gradient_that_is_not_a_number() -> None:
    batch = boxes_frame()
    above = VoxelLattice((-0.4, -0.4, 50.0), (0.4, 0.4, 0.4), (2, 2, 2))
    features = torch.randn(1, 2, 3, 8, 8, requires_grad=True)
    volume, bev = project_features(features, batch.cameras, batch.grid_from_camera(), above)
    (volume.sum() + bev.sum()).backward()
    assert (volume == 0).all()
    assert (features.grad == 0).all()


def test_relu_attention_is_the_weighted_mean_of_the_values() -> None:
    queries, keys, values = torch.randn(3, 2, 4, 9, dtype=torch.float32)
    attended = relu_attention(queries, keys, values)
    weights = torch.einsum("bdi,bdj->bij", queries.relu(), keys.relu())
    slow = torch.einsum("bij,bdj->bdi", weights / weights.sum(dim=2, keepdim=True).clamp(min=1e-12), values)
    torch.testing.assert_close(attended, slow, atol=1e-5, rtol=1e-4)


def test_a_block_of_efficientvit_sees_the_whole_map() -> None:
    torch.manual_seed(0)
    block = EfficientViTBlock(8, 4).eval()
    features = torch.randn(1, 8, 12, 12)
    changed = features.clone()
    changed[..., 11, 11] += 5.0
    assert ((block(features) - block(changed))[..., 0, 0].abs() > 1e-7).any()


def points(rows: list[list[float]], frames: list[int]) -> Points:
    return Points(torch.tensor(rows), torch.tensor(frames))


def encoded_slowly(encoder: VoxelFeatureEncoder, given: Points, frames: int) -> Tensor:
    """A loop over voxels, points of each in a list."""
    lattice = encoder.lattice
    dense = torch.zeros(frames, encoder.channels, *lattice.shape)
    place = (given.features[:, :3] - torch.tensor(lattice.min_m)) / torch.tensor(lattice.voxel_m)
    inside = ((place >= 0) & (place < torch.tensor(lattice.shape))).all(dim=1)
    keys = [(int(f), *map(int, p.floor())) for f, p in zip(given.frame, place, strict=True)]
    for key in {key for key, is_in in zip(keys, inside, strict=True) if is_in}:
        chosen = torch.tensor([other == key for other in keys]) & inside
        own = place[chosen]
        values = torch.cat([given.features[chosen], own - own.mean(dim=0), own - torch.tensor(key[1:]) - 0.5], dim=1)
        for layer in encoder.layers[:-1]:
            out = layer(values)
            values = torch.cat([out, out.amax(dim=0).expand_as(out)], dim=1)
        dense[key[0], :, key[1], key[2], key[3]] = encoder.layers[-1](values).amax(dim=0)
    return dense


def test_voxel_features_are_those_of_a_loop_over_voxels() -> None:
    torch.manual_seed(0)
    encoder = VoxelFeatureEncoder(5, (4, 6), LATTICE).eval()
    features = torch.randn(300, 5)
    given = Points(features, torch.arange(300) // 150)
    torch.testing.assert_close(encoder(given, 2), encoded_slowly(encoder, given, 2), atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("rows", [[], [[0.1, 0.1, 0.1, 0.0, 0.0]], [[float("nan")] * 5, [99.0] * 5]])
def test_no_points_at_all_are_an_empty_volume_in_training_too(rows: list[list[float]]) -> None:
    volumes = PointVolumes(5, (4, 8), (4, 4), LATTICE)
    given = Points(torch.tensor(rows).reshape(-1, 5), torch.zeros(len(rows), dtype=torch.int64))
    fine, coarse = volumes(given, 1)
    assert fine.shape == (1, 4, 8, 8, 4)
    assert coarse.shape == (1, 4, 4, 4, 2)
    assert coarse.isfinite().all()
    (fine.sum() + coarse.sum()).backward()
    assert all(each.grad is not None and bool(each.grad.isfinite().all()) for each in volumes.parameters())


def test_focal_loss_without_focus_is_cross_entropy_and_falls_with_it() -> None:
    logits, labels = torch.randn(1, 4, 3, 3, 3), torch.randint(0, 4, (1, 3, 3, 3), dtype=torch.uint8)
    labels[0, 0] = 255
    whole = cross_entropy(logits, labels, torch.ones(4))
    torch.testing.assert_close(focal_loss(logits, labels, gamma=0.0, alpha=1.0), whole)
    assert focal_loss(logits, labels, gamma=2.0, alpha=1.0) < whole


def test_nothing_counted_costs_nothing() -> None:
    logits = torch.randn(1, 4, 2, 2, 2, requires_grad=True)
    loss = focal_loss(logits, torch.full((1, 2, 2, 2), 255, dtype=torch.uint8))
    loss.backward()
    assert loss == 0
    assert (logits.grad == 0).all()
