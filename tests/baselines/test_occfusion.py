"""OccFusion: its sizes are near the official ones, it answers on every lattice, and all of it learns."""

from dataclasses import replace

import pytest
import torch
from torch import nn

from baselines.lattice import VoxelLattice
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
