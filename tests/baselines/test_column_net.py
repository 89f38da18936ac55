"""ColumnNet: it answers on its lattice from any sensors, all of it learns, and it knows what it does not know."""

from dataclasses import replace

import pytest
import torch

from baselines.batch import Batch, Points
from baselines.models.column_net import ColumnNet, ColumnOutputs, hard_voxels
from baselines.models.column_net_config import ColumnNetConfig
from tests.baselines.boxes_frame import SMALL, boxes_frame

TINY = ColumnNetConfig(
    lattice=SMALL,
    heights=20,
    heights_below=5,
    widths=(8, 12, 16),
    depths=(1, 1, 1),
    head_channels=4,
    image_channels=4,
    image_pool=1,
)


def small_net(modality: str = "C+L+R") -> ColumnNet:
    torch.manual_seed(0)
    return ColumnNet(replace(TINY, modality=modality))  # type: ignore[arg-type]


def answered(model: ColumnNet, batch: Batch) -> ColumnOutputs:
    outputs: ColumnOutputs = model(batch)
    return outputs


@pytest.mark.parametrize("modality", ["C", "L", "R", "C+L", "C+R", "L+R", "C+L+R"])
def test_it_answers_on_its_lattice_from_any_sensors(modality: str) -> None:
    model, batch = small_net(modality), boxes_frame(frames=2)
    outputs = answered(model.eval(), batch)
    assert model.logits(outputs, batch).shape == (2, 4, *SMALL.shape)
    assert outputs.uncertainty().shape == (2, *SMALL.shape)
    assert model.logits(outputs, batch).isfinite().all()


def test_the_full_size_is_light_and_answers_on_the_benchmarks_grid() -> None:
    with torch.device("meta"):
        model = ColumnNet(ColumnNetConfig())
    assert model.lattice.is_benchmark()
    assert sum(parameter.numel() for parameter in model.parameters()) < 2_500_000


def test_every_parameter_gets_a_gradient_from_the_sum_of_the_losses() -> None:
    model, batch = small_net(), boxes_frame(frames=2)
    torch.stack(list(model.losses(answered(model, batch), batch).values())).sum().backward()
    assert [name for name, parameter in model.named_parameters() if parameter.grad is None] == []
    assert all(bool(each.grad.isfinite().all()) for each in model.parameters() if each.grad is not None)


def test_temperature_learns_without_touching_the_classes() -> None:
    model, batch = small_net(), boxes_frame()
    model.losses(answered(model, batch), batch)["temperature"].backward()
    moved = {name for name, each in model.named_parameters() if each.grad is not None and each.grad.any()}
    assert moved == {"net.warm.weight", "net.warm.bias"}


def test_temperature_changes_how_sure_it_is_and_nothing_else() -> None:
    logits = torch.randn(1, 4, 3, 3, 3)
    cold, warm = (ColumnOutputs(logits, torch.full((1, 1, 3, 3, 3), each)) for each in (-1.0, 2.0))
    assert torch.equal(cold.calibrated().argmax(1), warm.calibrated().argmax(1))
    assert (cold.uncertainty() < warm.uncertainty()).all()
    assert ((warm.uncertainty() > 0) & (warm.uncertainty() <= 1)).all()
    even = ColumnOutputs(torch.zeros(1, 4, 1, 1, 1), torch.zeros(1, 1, 1, 1, 1))
    torch.testing.assert_close(even.uncertainty(), torch.ones(1, 1, 1, 1))


def test_half_precision_answers_nearly_the_same() -> None:
    model, batch = small_net().eval(), boxes_frame()
    with torch.no_grad():
        whole = model.logits(answered(model, batch), batch)
        with torch.autocast("cpu", torch.bfloat16):
            half = model.logits(answered(model, batch), batch)
    assert (whole - half).abs().max() < 0.05 * whole.abs().max()


def test_frames_of_a_batch_do_not_see_each_other() -> None:
    model = small_net().eval()
    with torch.no_grad():
        both, one = answered(model, boxes_frame(frames=2)), answered(model, boxes_frame(frames=1))
    assert torch.equal(both.logits[:1].argmax(1), one.logits.argmax(1))


def test_a_higher_base_is_the_same_answer_higher_up() -> None:
    model = small_net().eval()
    maps, base = model.columns(boxes_frame())
    with torch.no_grad():
        logits, _ = model.net(maps, base)
        raised, _ = model.net(maps, base + 2)
    torch.testing.assert_close(raised[..., 2:], logits[..., :-2])


def test_a_frame_without_a_single_point_is_answered() -> None:
    model, batch = small_net().eval(), boxes_frame()
    none = torch.zeros(0, dtype=torch.int64)
    empty = replace(batch, lidar=Points(torch.zeros(0, 5), none), radar=Points(torch.zeros(0, 7), none))
    assert answered(model, empty).logits.isfinite().all()


def test_hard_voxels_are_the_occupied_and_the_doubtful() -> None:
    logits = torch.zeros(1, 4, 1, 1, 4)
    logits[:, 0] = 20.0
    logits[0, 0, 0, 0, 2] = 0.0  # doubtful
    labels = torch.tensor([0, 2, 0, 255], dtype=torch.uint8).reshape(1, 1, 1, 4)
    scores, classes = hard_voxels(logits, labels)
    assert classes.tolist() == [2, 0]
    assert scores.shape == (2, 4)
