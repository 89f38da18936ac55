"""OccFormer whole: the official number of parameters, shapes, gradients of everything, half precision, resampling."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.nn import functional

from baselines.batch import Batch, CameraViews
from baselines.lattice import VoxelLattice
from baselines.layers.masked_attention import MaskPrediction
from baselines.models.occformer import OccFormer, class_logits
from baselines.models.occformer_config import OccFormerConfig, official_r50

LATTICE = VoxelLattice((-3.2, -3.2, -0.8), (0.2, 0.2, 0.2), (32, 32, 16))
SMALL = OccFormerConfig(
    lattice=LATTICE,
    backbone_depth=14,
    backbone_width=4,
    backbone_deformable_stages=(False, False, False, True),
    backbone_frozen_stages=-1,
    backbone_norm_eval=False,
    neck_channels=4,
    depth_range_m=(0.5, 4.5),
    stage_channels=(16, 16, 16, 32),
    stage_blocks=(1, 1, 1, 1),
    window=3,
    head_channels=8,
    drop_path=0.0,
    decoder_channels=12,
    pixel_layers=1,
    pixel_heads=2,
    queries=6,
    query_layers=3,
    query_heads=2,
    mask_points=200,
)


@pytest.fixture(autouse=True)
def _seeded() -> None:
    torch.manual_seed(0)
    torch.set_num_threads(1)


def frames(count: int = 2) -> Batch:
    """Two cameras, one forward, one backward, on random pictures, depths and labels."""
    forward = torch.tensor([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0.5], [0, 0, 0, 1]])
    backward = torch.diag(torch.tensor([-1.0, -1, 1, 1])) @ forward
    intrinsics = torch.tensor([[40.0, 0, 31.5], [0, 40, 15.5], [0, 0, 1]])
    cameras = CameraViews(
        images=torch.randn(count, 2, 3, 32, 64),
        intrinsics=intrinsics.expand(count, 2, 3, 3),
        augmented_from_image=torch.eye(3).expand(count, 2, 3, 3),
        ego_from_camera=torch.stack((forward, backward)).expand(count, 2, 4, 4),
        depth_m=torch.rand(count, 2, 32, 64) * 4.0 + 0.5,
    )
    labels = torch.randint(0, 4, (count, *LATTICE.shape), dtype=torch.uint8)
    return Batch(("a", "b")[:count], torch.eye(4).expand(count, 4, 4), cameras, labels=labels)


def total(terms: dict[str, Tensor]) -> Tensor:
    return torch.stack(list(terms.values())).sum()


def deviation(numbers: Tensor, expected: Tensor) -> float:
    """Root mean square of the difference, as a share of what is expected."""
    return ((numbers.float() - expected).square().mean() / expected.square().mean()).sqrt().item()


@pytest.mark.parametrize(
    ("config", "expected", "trained"),
    [(OccFormerConfig(), 167_770_683, 167_442_939), (official_r50(), 146_973_821, 146_964_285)],
)
def test_the_official_sizes_have_the_official_number_of_parameters(
    config: OccFormerConfig, expected: int, trained: int
) -> None:
    with torch.device("meta"):
        model = OccFormer(config)
    assert sum(p.numel() for p in model.parameters()) == expected
    assert sum(p.numel() for p in model.parameters() if p.requires_grad) == trained


def test_the_official_sizes_fit_together_from_the_lifted_volume_on() -> None:
    with torch.device("meta"):
        model = OccFormer(OccFormerConfig()).eval()
        volumes = model.encoder(torch.zeros(1, 128, 128, 128, 16))
        predictions = model.mask_decoder(*model.pixel_decoder(volumes))
    assert [tuple(v.shape[1:]) for v in volumes] == [
        (128, 128, 128, 16), (256, 64, 64, 8), (512, 32, 32, 4), (1024, 16, 16, 2),
    ]  # fmt: skip
    assert [tuple(p.masks.shape) for p in predictions] == [(1, 100, 128, 128, 16)] * 10


def test_outputs_are_masks_on_half_the_lattice_and_logits_on_all_of_it() -> None:
    model, batch = OccFormer(SMALL).eval(), frames()
    with torch.no_grad():
        outputs = model(batch)
    assert [tuple(p.masks.shape) for p in outputs.predictions] == [(2, 6, 16, 16, 8)] * 4
    assert tuple(outputs.depth.shape) == (2, 2, 8, 2, 4)
    logits = model.logits(outputs, batch)
    assert (logits.dtype, tuple(logits.shape)) == (torch.float32, (2, 4, 32, 32, 16))
    assert logits.isfinite().all()


def test_every_parameter_learns_from_the_sum_of_losses() -> None:
    model, batch = OccFormer(SMALL).train(), frames()
    with torch.no_grad():
        for parameter in model.parameters():  # weights of offsets begin as 0, and hold back what positions would learn
            parameter += 0.02 * torch.randn_like(parameter)
    terms = model.losses(model(batch), batch)
    assert set(terms) == {"class", "mask", "dice", "depth"}
    total(terms).backward()
    gradients = {name: p.grad for name, p in model.named_parameters()}
    assert [name for name, grad in gradients.items() if grad is None or not grad.isfinite().all()] == []
    assert [name for name, grad in gradients.items() if grad is not None and not grad.any()] == []


def test_half_precision_is_close_to_single() -> None:
    model, batch = OccFormer(SMALL).eval(), frames()
    with torch.no_grad():
        single = model.lifted(batch)[0], model(batch)
        with torch.autocast("cpu", torch.bfloat16):
            half = model.lifted(batch)[0], model(batch)
    assert deviation(half[0], single[0]) < 0.02
    assert deviation(half[1].predictions[0].masks, single[1].predictions[0].masks) < 0.05
    torch.manual_seed(1)
    expected = total(model.losses(single[1], batch))
    torch.manual_seed(1)
    with torch.autocast("cpu", torch.bfloat16):
        answered = total(model.losses(half[1], batch))
    assert answered.dtype == torch.float32
    assert answered.item() == pytest.approx(expected.item(), rel=0.05)


def test_checkpointing_changes_no_gradient() -> None:
    batch, gradients = frames(), []
    for is_saving in (False, True):
        torch.manual_seed(2)
        model = OccFormer(replace(SMALL, checkpoint_gradients=is_saving, drop_path=0.5)).train()
        total(model.losses(model(batch), batch)).backward()
        gradients.append([p.grad for p in model.parameters()])
    torch.testing.assert_close(gradients[0], gradients[1], atol=1e-5, rtol=1e-3)


@pytest.mark.parametrize("align_corners", [False, True])
def test_logits_are_the_shares_of_all_queries_summed(align_corners: bool) -> None:
    prediction = MaskPrediction(torch.randn(2, 23, 5), torch.randn(2, 23, 4, 4, 2))
    logits = class_logits(prediction, (8, 8, 4), align_corners)
    masks = functional.interpolate(prediction.masks, (8, 8, 4), mode="trilinear", align_corners=align_corners)
    expected = torch.zeros(2, 4, 8, 8, 4)
    for query in range(23):
        shares = prediction.classes[:, query].softmax(dim=1)[:, :4, None, None, None]
        expected += shares * masks[:, query, None].sigmoid()
    torch.testing.assert_close(logits.exp(), expected)
