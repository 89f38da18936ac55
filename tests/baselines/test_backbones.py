"""Pretrained image backbones: torchvision's names are taken, whole or not at all."""

from collections.abc import Mapping
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor, nn

from baselines.checkpoint import load_backbone
from baselines.errors import BadRunError
from baselines.layers.resnet import ResNet, ResNetConfig

SMALL = ResNetConfig(14, width=8)


class Model(nn.Module):
    """Something that sees pictures."""

    def __init__(self, config: ResNetConfig = SMALL) -> None:  # frozen
        super().__init__()
        self.cameras = nn.ModuleDict({"backbone": ResNet(config)})


def weights() -> dict[str, Tensor]:
    """As torchvision's files have them: with a classifier."""
    torch.manual_seed(5)
    state = {name: torch.rand_like(value.float()) for name, value in ResNet(SMALL).state_dict().items()}
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
    load_backbone(model, written(tmp_path / name, weights()))
    state = model.cameras["backbone"].state_dict()
    assert {"conv1.weight", "layer1.0.conv2.weight", "layer4.0.downsample.1.running_var"} <= weights().keys()
    for key, value in weights().items():
        assert key.startswith("fc.") or torch.equal(state[key], value)


def test_offsets_of_deformable_stages_may_be_missing(tmp_path: Path) -> None:
    model = Model(ResNetConfig(14, width=8, deformable_stages=(False, False, True, True)))
    load_backbone(model, written(tmp_path / "a.pth", weights()))
    assert not model.cameras["backbone"].layer3[0].conv2.conv_offset.weight.any()  # type: ignore[union-attr, index]


def lacking() -> dict[str, Tensor]:
    return {name: value for name, value in weights().items() if name != "layer3.0.conv1.weight"}


@pytest.mark.parametrize(
    ("tensors", "why"),
    [
        (lacking, "1 weights of this ResNet are not in the checkpoint, layer3.0.conv1.weight the first"),
        (lambda: {**weights(), "conv1.weight": torch.zeros(16, 3, 7, 7)}, "conv1.weight the first"),
        (lambda: {f"backbone.{name}": value for name, value in weights().items()}, "conv1.weight the first"),
        (dict, "are not in the checkpoint"),
    ],
)
def test_weights_that_do_not_fit_are_refused_and_none_is_taken(tmp_path: Path, tensors: object, why: str) -> None:
    model, before = Model(), None
    before = {name: value.clone() for name, value in model.state_dict().items()}
    with pytest.raises(BadRunError, match=why):
        load_backbone(model, written(tmp_path / "a.pth", tensors()))  # type: ignore[operator]
    assert all(torch.equal(value, before[name]) for name, value in model.state_dict().items())


class Hostile:
    """What a pickle could run."""

    def __reduce__(self) -> tuple[object, tuple[str, ...]]:
        return exec, ("raise SystemExit('it ran')",)


@pytest.mark.parametrize("name", ["a.pth", "a.safetensors"])
@pytest.mark.parametrize("content", [b"", b"weights", b"PK\3\4 no zip", b"\x80\x02]."])
def test_files_that_hold_no_weights_are_refused_in_one_line(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BadRunError, match=f"{name} lacks the weights") as refused:
        load_backbone(Model(), tmp_path / name)
    assert "\n" not in str(refused.value)


def test_nothing_that_a_file_brings_is_run(tmp_path: Path) -> None:
    torch.save({"conv1.weight": Hostile()}, tmp_path / "a.pth")
    with pytest.raises(BadRunError, match="lacks the weights") as refused:
        load_backbone(Model(), tmp_path / "a.pth")
    assert "\n" not in str(refused.value)


def test_a_file_of_one_tensor_is_refused(tmp_path: Path) -> None:
    torch.save(torch.zeros(3), tmp_path / "a.pth")
    with pytest.raises(BadRunError, match="lacks the weights"):
        load_backbone(Model(), tmp_path / "a.pth")


def test_a_row_without_cameras_has_no_backbone(tmp_path: Path) -> None:
    with pytest.raises(BadRunError, match="is of an image backbone, and this row has none"):
        load_backbone(nn.Linear(1, 1), written(tmp_path / "a.pth", weights()))
