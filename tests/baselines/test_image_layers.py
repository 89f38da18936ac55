"""Image layers: the published parameter counts, torchvision's keys, deformable convolution against a slow loop."""

from itertools import product
from math import floor

import pytest
import torch
from torch import Tensor
from torch.nn import functional

from baselines.layers.deformable_convolution import DeformableConv2d
from baselines.layers.pyramids import FPN, FPNConfig, SecondFPN
from baselines.layers.resnet import ResNet, ResNetConfig

SMALL = ResNetConfig(depth=14, width=4)
CLASSIFIER = {50: 2049000, 101: 2049000}  # fc of 2048 × 1000 + 1000, which a backbone has not
DEFORMABLE_101 = 23 * (256 * 27 * 9 + 27) + 3 * (512 * 27 * 9 + 27)  # a conv_offset in each block of stages 3 and 4


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


def test_a_resnet_101_with_deformable_stages_has_an_offset_convolution_more_per_block() -> None:
    with torch.device("meta"):
        model = ResNet(ResNetConfig(depth=101, deformable_stages=(False, False, True, True)))
    assert parameters(model) == 44549160 - CLASSIFIER[101] + DEFORMABLE_101
    assert model.state_dict()["layer3.22.conv2.conv_offset.weight"].shape == (27, 256, 3, 3)


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


def test_a_plain_checkpoint_loads_into_a_deformable_backbone_and_the_classifier_is_left() -> None:
    state = {**ResNet(SMALL).state_dict(), "fc.weight": torch.rand(10, 128), "fc.bias": torch.rand(10)}
    model = ResNet(ResNetConfig(depth=14, width=4, deformable_stages=(False, False, True, True)))
    model.load_pretrained(state)
    assert torch.equal(model.state_dict()["layer4.0.conv2.weight"], state["layer4.0.conv2.weight"])


def test_a_checkpoint_of_another_network_is_refused() -> None:
    with pytest.raises(ValueError, match="weights of this ResNet are not in the checkpoint"):
        ResNet(SMALL).load_pretrained(ResNet(ResNetConfig(depth=14, width=8)).state_dict())


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


@pytest.mark.parametrize("stride", [1, 2])
def test_without_offsets_it_is_half_the_plain_convolution(stride: int) -> None:
    layer = DeformableConv2d(3, 5, stride=stride)
    images = torch.randn(1, 3, 9, 8)
    plain = functional.conv2d(images, layer.weight, stride=stride, padding=1)
    torch.testing.assert_close(layer(images), plain / 2, rtol=1e-5, atol=1e-6)


def test_the_gradients_of_deformable_convolution_are_right() -> None:
    torch.manual_seed(2)
    layer = bent(DeformableConv2d(2, 2))
    images = torch.randn(1, 2, 3, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(layer, (images,))
    weights = dict(layer.named_parameters())
    assert torch.autograd.gradcheck(
        lambda *values: torch.func.functional_call(layer, dict(zip(weights, values, strict=True)), (images.detach(),)),
        tuple(value.detach().clone().requires_grad_() for value in weights.values()),
    )


def test_offsets_far_outside_see_nothing() -> None:
    layer = DeformableConv2d(2, 2)
    torch.nn.init.constant_(layer.conv_offset.bias, 1e6)  # type: ignore[arg-type]
    assert layer(torch.rand(1, 2, 4, 4)).abs().max() == 0


def test_an_fpn_adds_coarse_to_fine_and_makes_the_extra_levels_asked_for() -> None:
    maps = [torch.rand(1, channels, 32 >> level, 48 >> level) for level, channels in enumerate((3, 5, 7))]
    for extra_from in ("input", "output", "pool"):
        outputs = FPN(FPNConfig((3, 5, 7), 4, extra_levels=2, extra_from=extra_from))(maps)
        assert [tuple(level.shape) for level in outputs] == [(1, 4, 32 >> n, 48 >> n) for n in range(5)]
    model = FPN(FPNConfig((3, 5, 7), 4))
    before = model(maps)[0]
    maps[2] = maps[2] + 1
    assert (model(maps)[0] != before).any()


def test_the_fpn_of_tpvformer_has_its_official_number_of_parameters() -> None:
    with torch.device("meta"):
        model = FPN(FPNConfig((512, 1024, 2048), 256, extra_levels=1, extra_from="output"))
    assert parameters(model) == (512 + 1024 + 2048 + 3) * 256 + 4 * (256 * 256 * 9 + 256)


def test_a_second_fpn_joins_all_at_one_scale_with_the_official_number_of_parameters() -> None:
    with torch.device("meta"):
        model = SecondFPN((256, 512, 1024, 2048), (128,) * 4, (0.25, 0.5, 1, 2))
    assert parameters(model) == 128 * (256 * 16 + 512 * 4 + 1024 + 2048 * 4) + 4 * 2 * 128
    small = SecondFPN((2, 3, 4, 5), (6, 6, 6, 6), (0.25, 0.5, 1, 2))
    maps = [torch.rand(1, 2 + n, 32 >> n, 64 >> n) for n in range(4)]
    assert small(maps).shape == (1, 24, 8, 16)


def test_image_layers_under_bfloat16_stay_close_to_float32() -> None:
    torch.manual_seed(3)
    model = ResNet(ResNetConfig(depth=14, width=8, deformable_stages=(False, False, True, True))).eval()
    images = torch.randn(1, 3, 64, 64)
    exact = model(images)[-1]
    with torch.autocast("cpu", torch.bfloat16):
        near = model(images)[-1].float()
    assert (near - exact).norm() < 0.05 * exact.norm()
