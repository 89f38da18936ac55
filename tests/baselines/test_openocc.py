"""L-OpenOcc and L-CoNet have the official layers, and answer what a row must."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor, nn

from baselines.batch import IGNORED
from baselines.models.openocc import OpenOcc, by_own_value
from baselines.models.openocc_config import official_row
from baselines.models.openocc_lidar import lattice_of_points
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


def test_normalised_and_plain_terms_have_the_same_values() -> None:
    model, batch = row(), lidar_batch()
    outputs = model(batch)
    model.config = replace(model.config, normalises_losses=True)
    normalised = model.losses(outputs, batch)
    model.config = replace(model.config, normalises_losses=False)
    for name, term in model.losses(outputs, batch).items():
        assert normalised[name].item() == pytest.approx(term.item())


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
