"""TPVFormer: its size, its shapes, what it learns by, and that checkpoints change nothing."""

from dataclasses import replace

import pytest
import torch

from baselines.lattice import VoxelLattice
from baselines.layers.deformable_attention import SamplingHead
from baselines.layers.deformable_convolution import DeformableConv2d
from baselines.layers.grid_mask import GridMask, is_kept
from baselines.layers.tpv.camera_sight import CameraRig
from baselines.models.tpvformer import TPVFormer
from baselines.models.tpvformer_config import TPVFormerConfig
from tests.baselines.camera_frames import frames

torch.set_num_threads(1)
SMALL = TPVFormerConfig(
    lattice=VoxelLattice((-3.2, -3.2, -1.0), (0.4, 0.4, 0.4), (16, 16, 8)),
    cameras=3,
    channels=16,
    heads=2,
    anchors=(2, 4, 4),
    layers=2,
    feedforward_channels=32,
    hidden_channels=32,
    grid_mask_probability=0.0,
    backbone_depth=14,
    backbone_width=8,
    backbone_frozen_stages=-1,
    backbone_norm_eval=False,
)
SIZE_PX = (48, 80)  # not of multiples of 32


def model_of(config: TPVFormerConfig) -> TPVFormer:
    """One whose sampling depends on what is seen, as after training."""
    torch.manual_seed(0)
    model = TPVFormer(config)
    for part in model.modules():
        if isinstance(part, SamplingHead):
            torch.nn.init.normal_(part.offsets.weight, std=0.1)
            torch.nn.init.normal_(part.scores.weight, std=0.1)
        if isinstance(part, DeformableConv2d):
            torch.nn.init.normal_(part.conv_offset.weight, std=0.01)
    return model


def batch_of(config: TPVFormerConfig, size: int = 2):
    generator = torch.Generator().manual_seed(1)
    images = torch.randn(size, config.cameras, 3, *SIZE_PX, generator=generator)
    labels = torch.randint(0, 5, (size, *config.lattice.shape), generator=generator).to(torch.uint8)
    return frames(images, torch.where(labels == 4, 255, labels))


def test_it_has_exactly_the_parameters_of_the_official_modules() -> None:
    with torch.device("meta"):
        model = TPVFormer(TPVFormerConfig())
    assert sum(p.numel() for p in model.parameters()) == 65_070_146
    assert sum(p.numel() for p in model.parameters() if p.requires_grad) == 64_742_402
    assert model.config.plane_lattice().shape == (128, 128, 16)


def test_logits_are_of_every_class_and_voxel() -> None:
    model, batch = model_of(SMALL).eval(), batch_of(SMALL)
    logits = model.logits(model(batch), batch)
    assert logits.shape == (2, 4, *SMALL.lattice.shape)
    assert logits.dtype == torch.float32
    assert logits.isfinite().all()


def test_every_parameter_learns_by_the_losses() -> None:
    model, batch = model_of(SMALL), batch_of(SMALL)
    losses = model.losses(model(batch), batch)
    assert set(losses) == {"cross_entropy", "lovasz"}
    torch.stack(list(losses.values())).sum().backward()
    assert [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()] == []


def test_checkpointed_gradients_are_the_same() -> None:
    config = replace(SMALL, dropout=0.0)
    batch = batch_of(config)
    gradients = []
    for is_checkpointed in (False, True):
        model = model_of(replace(config, checkpoint_gradients=is_checkpointed))
        torch.stack(list(model.losses(model(batch), batch).values())).sum().backward()
        gradients.append([p.grad for p in model.parameters()])
    for plain, checkpointed in zip(*gradients, strict=True):
        torch.testing.assert_close(checkpointed, plain)


def test_a_frame_of_a_batch_is_predicted_as_if_it_were_alone() -> None:
    model, batch = model_of(SMALL).eval(), batch_of(SMALL)
    with torch.no_grad():
        torch.testing.assert_close(model(batch)[1:], model(frames(batch.cameras.images[1:])), rtol=1e-4, atol=1e-4)


def test_a_grid_mask_blanks_a_quarter_of_every_picture_in_squares_and_leaves_the_rest() -> None:
    torch.manual_seed(3)
    images = torch.rand(2, 3, 3, 64, 96) + 1
    blanked = []
    for _ in range(20):
        masked = GridMask(1.0)(images)
        kept = masked != 0
        assert torch.equal(masked[kept], images[kept])
        assert torch.equal(kept, kept[0, 0, 0].expand_as(kept))
        rows, columns = kept[0, 0, 0].all(dim=1), kept[0, 0, 0].all(dim=0)
        assert torch.equal(kept[0, 0, 0], rows[:, None] | columns)
        blanked.append(1 - kept.float().mean().item())
    assert 0.15 < sum(blanked) / len(blanked) < 0.35


def test_a_grid_mask_keeps_half_of_each_period() -> None:
    for period_px in (2, 3, 8):
        kept = is_kept(5 * period_px, period_px).reshape(5, period_px)
        assert (kept.sum(dim=1) == round(period_px / 2)).all()
        assert torch.equal(kept, kept[:1].expand_as(kept))


def test_pictures_are_blanked_as_often_as_asked_and_never_when_predicting() -> None:
    torch.manual_seed(0)
    images = torch.ones(1, 1, 3, 16, 16)
    assert sum(bool((GridMask(0.7)(images) == 0).any()) for _ in range(300)) == pytest.approx(210, abs=30)
    assert all(torch.equal(GridMask(1.0).eval()(images), images) for _ in range(5))


def test_under_autocast_it_answers_nearly_as_in_float32_and_learns_in_nearly_the_same_direction() -> None:
    found = []
    for is_half in (True, False):
        config = replace(SMALL, dropout=0.0)
        model, batch = model_of(config), batch_of(config)
        with torch.autocast("cpu", torch.bfloat16, enabled=is_half):
            outputs = model(batch)
            losses, logits = model.losses(outputs, batch), model.logits(outputs, batch)
        torch.stack(list(losses.values())).sum().backward()
        gradients = torch.cat([p.grad.flatten() for p in model.parameters() if p.grad is not None])
        found.append((logits.detach(), losses, gradients))
    (half, half_losses, half_gradients), (single, losses, gradients) = found
    assert {half.dtype, *(loss.dtype for loss in half_losses.values())} == {torch.float32}
    assert half_gradients.isfinite().all()
    assert (half - single).abs().mean() < 0.05 * single.std()
    for name, loss in losses.items():
        torch.testing.assert_close(half_losses[name], loss, rtol=0.02, atol=0.02)
    assert torch.cosine_similarity(half_gradients, gradients, dim=0) > 0.95


def test_geometry_is_the_same_under_autocast() -> None:
    batch = batch_of(SMALL)
    with torch.autocast("cpu", torch.bfloat16):
        half = CameraRig.of(batch)
    assert torch.equal(half.pixels_from_grid, CameraRig.of(batch).pixels_from_grid)


def test_it_tells_one_picture_from_another() -> None:
    """Queries of planes alone could remember one frame; of two, trained on together, pictures must say which it is."""
    lattice = VoxelLattice((-3.2, -3.2, -0.8), (0.8, 0.8, 0.8), (8, 8, 4))
    config = replace(SMALL, lattice=lattice, upscale=1, dropout=0.0, backbone_width=4, layers=1)
    images = torch.stack([torch.full((3, 3, 32, 32), value) for value in (-1.0, 1.0)])
    labels = torch.zeros(2, *lattice.shape, dtype=torch.uint8)
    labels[0, :, :, 1], labels[1, :, :, 2] = 1, 3
    batch = frames(images, labels)
    model = model_of(config)
    optimiser = torch.optim.AdamW(model.parameters(), 1e-2)
    for _ in range(60):
        optimiser.zero_grad()
        torch.stack(list(model.losses(model(batch), batch).values())).sum().backward()
        optimiser.step()
    with torch.no_grad():
        share = (model(batch).argmax(dim=1) == labels).float().mean()
    assert share > 0.97
