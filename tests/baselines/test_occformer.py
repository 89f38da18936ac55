"""OccFormer whole and its layers and losses: official sizes, slow loops and formulas written out beside them."""

from dataclasses import replace
from itertools import permutations, product
from math import cos, floor, pi, sin

import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.batch import IGNORED, Batch, CameraViews
from baselines.lattice import Shape, VoxelLattice
from baselines.layers.deformable_attention3d import (
    DeformableAttention3D,
    DeformableSettings3D,
    sample_volumes,
    voxel_places,
)
from baselines.layers.dual_path import DualPathEncoder, DualPathSettings
from baselines.layers.masked_attention import (
    MaskDecoder,
    MaskDecoderLayer,
    MaskPrediction,
    MemoryTokens,
    QuerySettings,
    hidden_voxels,
)
from baselines.layers.pixel_decoder3d import PixelDecoder3D, PixelDecoderSettings, sine_positions
from baselines.layers.shifted_windows import ShiftedWindowBlock, WindowAttention, WindowSettings, stochastic_depth
from baselines.losses.masks import (
    MaskLossSettings,
    PointSettings,
    contested_voxels,
    drawn_voxels,
    frame_masks,
    mask_losses,
    matched_queries,
    matching_cost,
    read_masks,
)
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


SHAPES: tuple[Shape, ...] = ((2, 3, 2), (4, 3, 3))
SMALL_WINDOWS = WindowSettings(window=3, head_channels=8, drop_path=0.0)
SMALL_PATHS = DualPathSettings(16, (16, 32, 32, 64), (2, 1, 1, 1), SMALL_WINDOWS, dropout=0.0)
SMALL_PIXELS = PixelDecoderSettings((16, 32, 32, 64), DeformableSettings3D(12, 2), layers=2, hidden=24)
SMALL_QUERIES = QuerySettings(queries=5, channels=12, heads=2, layers=4, hidden=24)


def slowly_attended(attention: WindowAttention, cells: Tensor, window: int, shift: int) -> Tensor:
    """Each cell by itself: it sees those of its window, whose borders lie `shift` cells further than without it."""
    height, width, channels = cells.shape
    q, k, v = attention.qkv(cells).chunk(3, dim=-1)
    size, places = channels // attention.heads, list(product(range(height), range(width)))
    table = attention.bias.reshape(2 * window - 1, 2 * window - 1, attention.heads)
    result = torch.zeros_like(cells)
    for row, column in places:
        seen = [
            (r, c) for r, c in places
            if (r - shift) // window == (row - shift) // window and (c - shift) // window == (column - shift) // window
        ]  # fmt: skip
        for head in range(attention.heads):
            own = slice(head * size, (head + 1) * size)
            bias = torch.stack([table[row - r + window - 1, column - c + window - 1, head] for r, c in seen])
            scores = torch.stack([q[row, column, own] @ k[r, c, own] / size**0.5 for r, c in seen]) + bias
            values = torch.stack([v[r, c, own] for r, c in seen])
            result[row, column, own] = scores.softmax(dim=0) @ values
    projected: Tensor = attention.project(result)
    return projected


@pytest.mark.parametrize("is_shifted", [False, True])
@pytest.mark.parametrize("size", [(6, 6), (5, 7), (2, 3)])
def test_a_block_attends_within_windows_as_a_slow_loop_does(is_shifted: bool, size: tuple[int, int]) -> None:
    block = ShiftedWindowBlock(16, is_shifted, SMALL_WINDOWS).double()
    nn.init.normal_(block.attention.bias)
    maps = torch.randn(2, 16, *size, dtype=torch.float64)
    answers = block(maps)
    for number, cells in enumerate(maps.permute(0, 2, 3, 1)):
        padded = torch.zeros(-(-size[0] // 3) * 3, -(-size[1] // 3) * 3, 16, dtype=torch.float64)
        padded[: size[0], : size[1]] = block.norm1(cells)
        attended = slowly_attended(block.attention, padded, 3, int(is_shifted))
        expected = cells + attended[: size[0], : size[1]]
        expected = expected + block.feed_forward(block.norm2(expected))
        torch.testing.assert_close(answers[number].permute(1, 2, 0), expected)


def test_a_dropped_branch_keeps_its_mean_and_is_dropped_for_whole_samples() -> None:
    branch = torch.ones(20_000, 2, 3)
    dropped = stochastic_depth(branch, 0.2)
    assert dropped.mean().item() == pytest.approx(1.0, abs=0.02)
    assert set(dropped.flatten(1).std(dim=1).tolist()) == {0.0}
    assert stochastic_depth(branch, 0.0) is branch


def test_the_encoder_halves_volumes() -> None:
    volumes = DualPathEncoder(SMALL_PATHS)(torch.randn(2, 16, 9, 8, 4))
    assert [tuple(v.shape) for v in volumes] == [
        (2, 16, 9, 8, 4), (2, 32, 5, 4, 2), (2, 32, 3, 2, 1), (2, 64, 2, 1, 1),
    ]  # fmt: skip


def slowly_sampled(values: Tensor, places: Tensor, weights: Tensor) -> Tensor:
    """Each reading by itself, from its eight voxels."""
    batch, queries, heads, levels, points, _ = places.shape
    result = torch.zeros(batch, queries, heads, values.shape[3], dtype=values.dtype)
    starts = [0, SHAPES[0][0] * SHAPES[0][1] * SHAPES[0][2]]
    ranges = (batch, queries, heads, levels, points)
    for b, q, h, level, p in product(*(range(n) for n in ranges)):
        shape = SHAPES[level]
        at = [float(places[b, q, h, level, p, 2 - axis]) * shape[axis] - 0.5 for axis in range(3)]
        for corner in product((0, 1), repeat=3):
            voxel = [floor(a) + c for a, c in zip(at, corner, strict=True)]
            if all(0 <= v < n for v, n in zip(voxel, shape, strict=True)):
                share = weights[b, q, h, level, p]
                for a, v in zip(at, voxel, strict=True):
                    share = share * (1.0 - abs(a - v))
                flat = starts[level] + (voxel[0] * shape[1] + voxel[1]) * shape[2] + voxel[2]
                result[b, q, h] += share * values[b, flat, h]
    return result.flatten(2)


def readings() -> tuple[Tensor, Tensor, Tensor]:
    """Values, places of which some lie outside, and weights."""
    values = torch.randn(2, 12 + 36, 2, 3, dtype=torch.float64)
    places = torch.rand(2, 4, 2, 2, 2, 3, dtype=torch.float64) * 1.4 - 0.2
    return values, places, torch.rand(2, 4, 2, 2, 2, dtype=torch.float64)


def test_volumes_are_sampled_as_a_slow_loop_does() -> None:
    values, places, weights = readings()
    expected = slowly_sampled(values, places, weights)
    torch.testing.assert_close(sample_volumes(values, SHAPES, places, weights), expected, rtol=1e-12, atol=1e-12)


def test_attention_begins_as_a_mean_of_voxels_one_to_four_steps_away() -> None:
    settings = DeformableSettings3D(channels=4, heads=4, levels=1, points=2)
    attention = DeformableAttention3D(settings)
    for layer in (attention.values, attention.project):
        nn.init.eye_(layer.weight)
    values = torch.randn(1, 7 * 7 * 7, 4)
    read = attention(values, voxel_places(((7, 7, 7),)), values, ((7, 7, 7),)).reshape(7, 7, 7, 4)
    volume = values.reshape(7, 7, 7, 4)
    # The first head's ray is (z, y, x) = (1, 0, ½): its last coordinate is half of a voxel along x.
    expected = (volume[3, 3, 4, 0] + volume[4, 3, 4, 0]) / 4 + volume[4, 3, 5, 0] / 2
    torch.testing.assert_close(read[3, 3, 3, 0], expected)


def test_positions_are_sines_and_cosines_of_each_axis_in_turn() -> None:
    positions = sine_positions((3, 4, 5), 24).reshape(3, 4, 5, 24)
    for axis, index, length in ((0, 1, 3), (1, 2, 4), (2, 3, 5)):
        phase = 2.0 * pi * (index + 1) / length
        for wave in range(4):
            angle = phase / 10_000.0 ** (2 * wave / 8)
            both = positions[1, 2, 3, 8 * axis + 2 * wave : 8 * axis + 2 * wave + 2]
            torch.testing.assert_close(both, torch.tensor([sin(angle), cos(angle)]), atol=1e-5, rtol=0.0)


def test_the_pixel_decoder_keeps_shapes() -> None:
    levels = tuple(torch.randn(2, c, n, n, m) for c, n, m in ((16, 8, 4), (32, 4, 2), (32, 2, 1), (64, 1, 1)))
    features, memories = PixelDecoder3D(SMALL_PIXELS)(levels)
    assert tuple(features.shape) == (2, 12, 8, 8, 4)
    assert [tuple(m.shape) for m in memories] == [(2, 12, 1, 1, 1), (2, 12, 2, 2, 1), (2, 12, 4, 4, 2)]


def test_the_mask_decoder_answers_at_first_and_after_each_layer() -> None:
    memories = tuple(torch.randn(2, 12, n, n, 1) for n in (1, 2, 4))
    predictions = MaskDecoder(SMALL_QUERIES)(torch.randn(2, 12, 8, 8, 2), memories)
    assert [tuple(p.classes.shape) for p in predictions] == [(2, 5, 5)] * 5
    assert [tuple(p.masks.shape) for p in predictions] == [(2, 5, 8, 8, 2)] * 5


def test_a_query_sees_only_where_its_mask_is() -> None:
    layer = MaskDecoderLayer(SMALL_QUERIES)
    queries, tokens, position = torch.randn(1, 5, 12), torch.randn(1, 8, 12), torch.randn(5, 12)
    hidden = torch.zeros(2, 5, 8, dtype=torch.bool)
    hidden[:, :, 3:] = True
    changed = tokens.clone()
    changed[:, 3:] += 1.0
    answers = [layer(queries, position, MemoryTokens(t, t), hidden) for t in (tokens, changed)]
    torch.testing.assert_close(answers[0], answers[1])
    changed[:, :3] += 1.0
    assert not torch.allclose(answers[0], layer(queries, position, MemoryTokens(changed, changed), hidden))


def test_a_mask_hides_what_it_does_not_cover_and_nothing_where_it_covers_nothing() -> None:
    masks = torch.full((1, 2, 4, 4, 2), -1.0)
    masks[0, 0, 3, 0, 1] = 2.0
    hidden = hidden_voxels(masks, (2, 2, 1))
    assert hidden.tolist() == [[[True, True, False, True], [False] * 4]]


SETTINGS = MaskLossSettings((1000, 10, 100, 200), PointSettings(points=4_000))  # more than there are voxels: all
MASK_SHAPE = (8, 6, 4)


def random_labels() -> Tensor:
    labels = torch.randint(0, 4, MASK_SHAPE, dtype=torch.uint8)
    labels[:2] = IGNORED
    return labels


def rarity() -> Tensor:
    return torch.tensor(SETTINGS.rarity())


def perfect(labels: Tensor, queries: int = 6) -> MaskPrediction:
    """Queries 1 to 4 are sure of a class and its voxels, the others of nothing."""
    classes = torch.full((1, queries, 5), -20.0)
    classes[0, :, 4] = 20.0
    masks = torch.full((1, queries, *labels.shape), -20.0)
    for label in range(4):
        classes[0, label + 1, 4], classes[0, label + 1, label] = -20.0, 20.0
        masks[0, label + 1][labels == label] = 20.0
    return MaskPrediction(classes, masks)


@pytest.mark.parametrize("align_corners", [False, True])
@pytest.mark.parametrize("shape", [(4, 3, 2), (8, 6, 4)])
def test_reading_at_every_voxel_is_resampling(align_corners: bool, shape: tuple[int, int, int]) -> None:
    masks = torch.randn(2, 3, *shape)
    voxels = torch.arange(8 * 6 * 4).expand(2, -1)
    expected = functional.interpolate(masks, size=MASK_SHAPE, mode="trilinear", align_corners=align_corners).flatten(2)
    torch.testing.assert_close(read_masks(masks, voxels, MASK_SHAPE, align_corners), expected, atol=1e-5, rtol=1e-5)


def test_drawn_voxels_differ_are_labelled_and_follow_the_seed() -> None:
    frame = frame_masks(random_labels(), rarity())
    torch.manual_seed(3)
    voxels = drawn_voxels(frame.rarity, 2, 40)
    assert all(len(set(row)) == 40 for row in voxels.tolist())
    assert (frame.rarity[voxels] > 0).all()
    torch.manual_seed(3)
    assert torch.equal(voxels, drawn_voxels(frame.rarity, 2, 40))
    assert sorted(drawn_voxels(frame.rarity, 1, 10_000)[0].tolist()) == frame.rarity.nonzero()[:, 0].tolist()


def test_rare_classes_are_drawn_in_proportion_to_the_fourth_root_of_their_rarity() -> None:
    labels = torch.zeros(100, 100, 2, dtype=torch.uint8)
    labels[:, :, 1] = 1
    frame = frame_masks(labels, rarity())
    drawn = drawn_voxels(frame.rarity, 10, 1_000) % 2
    assert drawn.float().mean().item() == pytest.approx(100**0.25 / (1 + 100**0.25), abs=0.02)


def test_three_quarters_of_the_voxels_are_the_least_decided_of_those_drawn() -> None:
    labels = torch.zeros(10, 10, 10, dtype=torch.uint8)
    masks = torch.full((1, 10, 10, 10), 9.0)
    masks[0, :3] = 0.1
    settings = PointSettings(points=100)
    voxels = contested_voxels(masks, frame_masks(labels, rarity()), settings)[0]
    assert len(voxels) == 100
    assert masks.flatten()[voxels[:75]].tolist() == pytest.approx([0.1] * 75)
    assert len(set(voxels[:75].tolist())) == 75


def test_the_cost_of_a_match_is_the_formula_written_out() -> None:
    classes, logits = torch.randn(3, 5), torch.randn(3, 7)
    present, targets = torch.tensor([0, 2]), (torch.rand(2, 7) > 0.5).float()
    cost = matching_cost(classes, logits, present, targets, SETTINGS)
    for query, row in enumerate(logits):
        for number, target in enumerate(targets):
            chance, covered = classes[query].softmax(0)[present[number]], row.sigmoid()
            entropy = -(target * covered.log() + (1 - target) * (1 - covered).log()).mean()
            dice = 1 - (2 * (covered * target).sum() + 1) / (covered.sum() + target.sum() + 1)
            torch.testing.assert_close(cost[query, number], -2 * chance + 5 * entropy + 5 * dice)


def test_queries_are_matched_at_the_least_cost_of_all_permutations() -> None:
    labels = random_labels()
    frame = frame_masks(labels, rarity())
    classes, masks = torch.randn(6, 5), torch.randn(6, *MASK_SHAPE)
    queries = matched_queries(classes, masks, frame, SETTINGS)
    counted = frame.rarity > 0
    logits, targets = masks.flatten(1)[:, counted], frame.masks[:, counted].float()
    cost = matching_cost(classes, logits, frame.classes, targets, SETTINGS).tolist()
    best = min(permutations(range(6), 4), key=lambda some: sum(cost[q][g] for g, q in enumerate(some)))
    assert queries.tolist() == list(best)


def test_a_perfect_prediction_costs_nothing_and_a_wrong_one_much() -> None:
    labels = random_labels()
    right = mask_losses([perfect(labels)], labels[None], SETTINGS)
    moved = mask_losses([perfect(labels.flip(0))], labels[None], SETTINGS)
    renamed = mask_losses([perfect((labels + 1) % 4)], labels[None], SETTINGS)
    assert all(term.item() == pytest.approx(0.0, abs=1e-3) for term in right.values())
    assert min(moved["mask"], moved["dice"]).item() > 1.0
    assert renamed["class"].item() > 1.0


def test_terms_are_the_formulas_written_out_summed_over_predictions() -> None:
    labels = random_labels()
    frame = frame_masks(labels, rarity())
    predictions = [MaskPrediction(torch.randn(1, 6, 5), torch.randn(1, 6, *MASK_SHAPE)) for _ in range(2)]
    expected = torch.zeros(3)
    weights = torch.tensor([1.0, 3.0, 1.5, 1.3037472, 0.1])  # ln 1000 / ln count
    for prediction in predictions:
        queries = matched_queries(prediction.classes[0], prediction.masks[0], frame, SETTINGS)
        asked = torch.full((6,), 4)
        asked[queries] = torch.arange(4)
        expected[0] += 2 * functional.cross_entropy(prediction.classes[0], asked, weights)
        for label in range(4):
            target = (labels == label)[labels != IGNORED].float().repeat(2)  # drawn as undecided, and uniformly
            logits = prediction.masks[0, queries[label]][labels != IGNORED].repeat(2)
            share = weights[label] / weights[:4].sum()
            expected[1] += 5 * share * functional.binary_cross_entropy_with_logits(logits, target)
            covered = logits.sigmoid()
            dice = 1 - (2 * (covered * target).sum() + 1) / (covered.sum() + target.sum() + 1)
            expected[2] += 5 * share * dice
    terms = mask_losses(predictions, labels[None], SETTINGS)
    torch.testing.assert_close(torch.stack([terms["class"], terms["mask"], terms["dice"]]), expected)


def test_frames_of_other_classes_or_of_none_are_learnt_from_together() -> None:
    labels = torch.stack([random_labels(), torch.full(MASK_SHAPE, IGNORED, dtype=torch.uint8), random_labels() % 2])
    classes = torch.randn(3, 6, 5, requires_grad=True)
    masks = torch.randn(3, 6, 4, 3, 2, requires_grad=True)
    terms = mask_losses([MaskPrediction(classes, masks)], labels, SETTINGS)
    sum(terms.values()).backward()  # type: ignore[union-attr]
    assert (classes.grad.abs().sum(dim=(1, 2)) > 0).all()
    assert (masks.grad.abs().flatten(1).sum(dim=1) > 0).tolist() == [True, False, True]


def test_a_batch_without_a_label_has_finite_terms() -> None:
    labels = torch.full((1, *MASK_SHAPE), IGNORED, dtype=torch.uint8)
    masks = torch.randn(1, 6, 4, 3, 2, requires_grad=True)
    terms = mask_losses([MaskPrediction(torch.randn(1, 6, 5), masks)], labels, SETTINGS)
    assert terms["mask"].item() == terms["dice"].item() == 0.0
    assert terms["class"].isfinite()
    (terms["mask"] + terms["dice"]).backward()
    assert masks.grad is not None


def test_a_class_that_is_never_seen_has_no_weight() -> None:
    with pytest.raises(ValueError, match="more than one voxel"):
        MaskLossSettings((1000, 1, 100, 200))
