"""Layers of pictures: published sizes, torchvision's weights, deformed convolution and lifting by slow loops."""

from collections.abc import Callable, Mapping
from itertools import pairwise, product
from math import erf, floor, log, sqrt
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor, nn

import baselines  # noqa: F401  # it chooses the instructions, before oneDNN is first used
from baselines.batch import Batch, CameraViews
from baselines.checkpoint import load_backbone
from baselines.lattice import VoxelLattice
from baselines.layers.deformable_convolution import DeformableConv2d
from baselines.layers.depth_network import DepthNetwork, DepthNetworkConfig, camera_vectors
from baselines.layers.lifting import Frustum, lift, splat
from baselines.layers.pyramids import FPN, FPNConfig, SecondFPN
from baselines.layers.resnet import ResNet, ResNetConfig
from baselines.layers.visible_fusion import VisibleFusion
from baselines.losses.depth import depth_cross_entropy, depth_divergence, nearest_depth
from testing.refusals import refused_as

SMALL = ResNetConfig(depth=14, width=4)
CLASSIFIER = {50: 2049000, 101: 2049000}  # fc of 2048 × 1000 + 1000, which a backbone has not


def parameters(module: torch.nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


def bilinear(image: Tensor, v: float, u: float) -> Tensor:
    """Of an image (C, H, W), one corner after another."""
    value = torch.zeros(len(image), dtype=image.dtype)
    for row, column in product((floor(v), floor(v) + 1), (floor(u), floor(u) + 1)):
        if 0 <= row < image.shape[1] and 0 <= column < image.shape[2]:
            value += (1 - abs(v - row)) * (1 - abs(u - column)) * image[:, row, column]
    return value


def slowly_deformed(layer: DeformableConv2d, images: Tensor) -> Tensor:
    """Each output pixel by itself, from the sum in the module's head."""
    predicted = layer.conv_offset(images)
    count, _, height, width = predicted.shape
    result = torch.zeros(count, len(layer.weight), height, width, dtype=images.dtype)
    per_group_in, per_group_out = layer.weight.shape[1], len(layer.weight) // layer.groups
    for n, row, column, tap in product(range(count), range(height), range(width), range(9)):
        dv, du = predicted[n, 2 * tap : 2 * tap + 2, row, column].tolist()
        v, u = row * layer.stride + tap // 3 - 1 + dv, column * layer.stride + tap % 3 - 1 + du
        seen = bilinear(images[n], v, u)
        if layer.is_modulated:
            seen = seen * predicted[n, 18 + tap, row, column].sigmoid()
        for out in range(len(layer.weight)):
            first = out // per_group_out * per_group_in
            result[n, out, row, column] += layer.weight[out, :, tap // 3, tap % 3] @ seen[first : first + per_group_in]
    return result


def bent(layer: DeformableConv2d) -> DeformableConv2d:
    """The layer in float64 with offsets of some pixels."""
    torch.nn.init.normal_(layer.conv_offset.weight, std=0.5)
    torch.nn.init.normal_(layer.conv_offset.bias)  # type: ignore[arg-type]
    return layer.double()


@pytest.mark.parametrize(("depth", "total"), [(50, 25557032), (101, 44549160)])
def test_a_resnet_has_the_published_number_of_parameters(depth: int, total: int) -> None:
    with torch.device("meta"):
        assert parameters(ResNet(ResNetConfig(depth=depth))) == total - CLASSIFIER[depth]  # type: ignore[arg-type]


def test_the_keys_are_those_of_torchvision() -> None:
    with torch.device("meta"):
        keys = list(ResNet(ResNetConfig()).state_dict())
    assert keys[:7] == [
        "conv1.weight",
        *(f"bn1.{name}" for name in ("weight", "bias", "running_mean", "running_var", "num_batches_tracked")),
        "layer1.0.conv1.weight",
    ]
    assert "layer1.0.downsample.0.weight" in keys
    assert "layer4.2.bn3.running_var" in keys
    assert len(keys) == 320 - 2  # of torchvision's resnet50 without fc


def test_maps_have_strides_4_to_32_and_the_widths_of_the_configuration() -> None:
    for style in ("pytorch", "caffe"):
        maps = ResNet(ResNetConfig(depth=14, width=4, style=style))(torch.rand(2, 3, 64, 96))
        assert [tuple(m.shape) for m in maps] == [
            (2, channels, 64 // stride, 96 // stride)
            for channels, stride in zip(SMALL.channels(), (4, 8, 16, 32), strict=True)
        ]


def test_frozen_stages_neither_learn_nor_move_their_statistics() -> None:
    model = ResNet(ResNetConfig(depth=14, width=4, frozen_stages=1)).train()
    model(torch.rand(1, 3, 64, 64))[-1].sum().backward()
    held = {name.split(".")[0] for name, parameter in model.named_parameters() if not parameter.requires_grad}
    assert held == {"conv1", "bn1", "layer1"}
    assert torch.equal(model.bn1.running_mean, torch.zeros(4))  # type: ignore[arg-type]
    assert all(parameter.grad is not None for parameter in model.layer2.parameters())


def test_norm_eval_holds_every_statistic_in_training() -> None:
    model = ResNet(ResNetConfig(depth=14, width=4, norm_eval=True)).train()
    model(torch.rand(1, 3, 64, 64))
    assert model.training
    assert all(int(value) == 0 for key, value in model.state_dict().items() if "num_batches" in key)


def test_checkpointed_gradients_are_the_same_gradients() -> None:
    images, gradients = torch.rand(1, 3, 64, 64), []
    for is_checkpointed in (False, True):
        torch.manual_seed(0)
        model = ResNet(ResNetConfig(depth=14, width=4, checkpoint_gradients=is_checkpointed)).train()
        model(images)[-1].square().sum().backward()
        gradients.append(model.conv1.weight.grad)
    torch.testing.assert_close(gradients[0], gradients[1])


@pytest.mark.parametrize("is_modulated", [True, False])
@pytest.mark.parametrize(("stride", "groups"), [(1, 1), (2, 2)])
def test_deformable_convolution_is_the_sum_of_its_definition(stride: int, groups: int, is_modulated: bool) -> None:
    torch.manual_seed(1)
    layer = bent(DeformableConv2d(4, 6, stride=stride, groups=groups, is_modulated=is_modulated))
    images = torch.randn(2, 4, 7, 5, dtype=torch.float64)
    torch.testing.assert_close(layer(images), slowly_deformed(layer, images), rtol=0, atol=1e-12)


def test_an_fpn_adds_coarse_to_fine_and_makes_the_extra_levels_asked_for() -> None:
    maps = [torch.rand(1, channels, 32 >> level, 48 >> level) for level, channels in enumerate((3, 5, 7))]
    for extra_from in ("input", "output", "pool"):
        outputs = FPN(FPNConfig((3, 5, 7), 4, extra_levels=2, extra_from=extra_from))(maps)
        assert [tuple(level.shape) for level in outputs] == [(1, 4, 32 >> n, 48 >> n) for n in range(5)]
    model = FPN(FPNConfig((3, 5, 7), 4))
    before = model(maps)[0]
    maps[2] = maps[2] + 1
    assert (model(maps)[0] != before).any()


def test_a_second_fpn_joins_all_at_one_scale() -> None:
    small = SecondFPN((2, 3, 4, 5), (6, 6, 6, 6), (0.25, 0.5, 1, 2))
    maps = [torch.rand(1, 2 + n, 32 >> n, 64 >> n) for n in range(4)]
    assert small(maps).shape == (1, 24, 8, 16)


NARROW = ResNetConfig(14, width=8)


class Model(nn.Module):
    """Something that sees pictures."""

    def __init__(self, config: ResNetConfig = NARROW) -> None:  # frozen
        super().__init__()
        self.cameras = nn.ModuleDict({"backbone": ResNet(config)})


def of_torchvision() -> dict[str, Tensor]:
    """As torchvision's files have them: with a classifier."""
    torch.manual_seed(5)
    state = {name: torch.rand_like(value.float()) for name, value in ResNet(NARROW).state_dict().items()}
    state = {name: value for name, value in state.items() if "num_batches" not in name}
    return {**state, "fc.weight": torch.zeros(10, 256), "fc.bias": torch.zeros(10)}


def written(path: Path, tensors: Mapping[str, Tensor]) -> Path:
    if path.suffix == ".safetensors":
        save_file(dict(tensors), path)
    else:
        torch.save(dict(tensors), path)
    return path


@pytest.mark.parametrize("name", ["resnet.safetensors", "resnet.pth"])
def test_torchvisions_weights_are_taken(name: str, tmp_path: Path) -> None:
    model = Model()
    load_backbone(model, written(tmp_path / name, of_torchvision()))
    state = model.cameras["backbone"].state_dict()
    assert {"conv1.weight", "layer1.0.conv2.weight", "layer4.0.downsample.1.running_var"} <= of_torchvision().keys()
    for key, value in of_torchvision().items():
        assert key.startswith("fc.") or torch.equal(state[key], value)


def test_offsets_of_deformable_stages_may_be_missing(tmp_path: Path) -> None:
    model = Model(ResNetConfig(14, width=8, deformable_stages=(False, False, True, True)))
    load_backbone(model, written(tmp_path / "a.pth", of_torchvision()))
    assert not model.cameras["backbone"].layer3[0].conv2.conv_offset.weight.any()  # type: ignore[union-attr, index]


def lacking() -> dict[str, Tensor]:
    return {name: value for name, value in of_torchvision().items() if name != "layer3.0.conv1.weight"}


def of_another_width() -> dict[str, Tensor]:
    return {**of_torchvision(), "conv1.weight": torch.zeros(16, 3, 7, 7)}


def of_other_names() -> dict[str, Tensor]:
    return {f"backbone.{name}": value for name, value in of_torchvision().items()}


@pytest.mark.parametrize("tensors", [lacking, of_another_width, of_other_names, dict])
def test_weights_that_do_not_fit_are_refused_and_none_is_taken(
    tmp_path: Path, tensors: Callable[[], dict[str, Tensor]]
) -> None:
    model = Model()
    before = {name: value.clone() for name, value in model.state_dict().items()}
    with refused_as("bad_run"):
        load_backbone(model, written(tmp_path / "a.pth", tensors()))
    assert all(torch.equal(value, before[name]) for name, value in model.state_dict().items())


class Hostile:
    """What a pickle could run."""

    def __reduce__(self) -> tuple[object, tuple[str, ...]]:
        return exec, ("raise SystemExit('it ran')",)


@pytest.mark.parametrize("name", ["a.pth", "a.safetensors"])
@pytest.mark.parametrize("content", [b"", b"weights", b"PK\3\4 no zip", b"\x80\x02]."])
def test_files_that_hold_no_weights_are_refused_in_one_line(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with refused_as("bad_run") as refused:
        load_backbone(Model(), tmp_path / name)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("saved", [{"conv1.weight": Hostile()}, torch.zeros(3)])
def test_nothing_that_a_file_brings_is_run(tmp_path: Path, saved: object) -> None:
    torch.save(saved, tmp_path / "a.pth")
    with refused_as("bad_run") as refused:
        load_backbone(Model(), tmp_path / "a.pth")
    assert "\n" not in str(refused.value)


def test_a_row_without_cameras_has_no_backbone(tmp_path: Path) -> None:
    with refused_as("bad_run"):
        load_backbone(nn.Linear(1, 1), written(tmp_path / "a.pth", of_torchvision()))


FAR = 0.01  # bfloat16 keeps eight bits: 0.003 was measured


def test_a_convolution_in_bfloat16_is_near_that_in_single_precision() -> None:
    """On a processor with matrix tiles (AMX) this fails where `baselines` does not keep oneDNN from them."""
    torch.manual_seed(0)
    for channels, side, stride in product([8, 12, 16, 24, 64], [2, 4, 8, 16], [1, 2, 4, 8, 16]):
        images, weights = torch.randn(2, channels, 16, 24), torch.randn(16, channels, side, side)
        exact = torch.conv2d(images, weights, stride=stride)
        near = torch.conv2d(images.bfloat16(), weights.bfloat16(), stride=stride).float()
        assert (near - exact).norm() < FAR * exact.norm(), (channels, side, stride)


LATTICE = VoxelLattice((-8.0, -8.0, -2.0), (1.0, 1.0, 1.0), (16, 16, 4))
FRUSTUM = Frustum(1.0, 9.0, 1.0, stride=4)
MAP_SHAPE = (3, 4)  # of the feature map
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
    depth = torch.randn(frames, cameras, FRUSTUM.bins, *MAP_SHAPE, dtype=torch.float64).softmax(dim=2)
    return depth, torch.randn(frames, cameras, 5, *MAP_SHAPE, dtype=torch.float64)


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
    volume = splat(depth, context, FRUSTUM.points(image_from_camera, poses, MAP_SHAPE), LATTICE)
    expected = slowly_splat(depth, context, image_from_camera, poses)
    assert expected.abs().sum() > 10
    torch.testing.assert_close(volume, expected, rtol=0, atol=1e-12)


def test_points_that_are_not_numbers_count_nowhere() -> None:
    depth, context = maps(1, 1)
    assert splat(depth, context, torch.full((1, 1, 8, *MAP_SHAPE, 3), torch.nan), LATTICE).abs().sum() == 0


def test_lifting_under_autocast_is_done_in_float32() -> None:
    logits, context = torch.randn(1, 2, 8, *MAP_SHAPE), torch.randn(1, 2, 5, *MAP_SHAPE)
    points = FRUSTUM.points(*(value.float() for value in rig(1, 2)), MAP_SHAPE)
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
