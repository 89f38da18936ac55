"""TPVFormer and its parts: planes and anchors, what cameras see, attentions against slow loops, what it learns by."""

from dataclasses import replace
from math import floor

import pytest
import torch
from torch.nn import functional

from baselines.lattice import VoxelLattice
from baselines.layers.deformable_attention import SamplingHead, by_head, deformable_attention
from baselines.layers.deformable_convolution import DeformableConv2d
from baselines.layers.grid_mask import GridMask, is_kept
from baselines.layers.tpv.aggregator import TPVAggregator, TPVAggregatorConfig
from baselines.layers.tpv.attention import (
    CrossViewHybridAttention,
    ImageCrossAttention,
    PlaneAttentionConfig,
    cell_centres,
)
from baselines.layers.tpv.camera_sight import CameraRig, ColumnSights, column_sights, projected
from baselines.layers.tpv.encoder import TriPlanes, anchor_points_m, as_planes, plane_sizes
from baselines.models.tpvformer import TPVFormer
from baselines.models.tpvformer_config import TPVFormerConfig
from tests.baselines.camera_scene import CAMERA_M, frames

torch.set_num_threads(1)
LATTICE = VoxelLattice((-3.2, -2.4, -1.0), (0.8, 0.8, 0.5), (8, 6, 4))
SIZE_PX = (32, 48)
CONFIG = PlaneAttentionConfig(channels=8, heads=2, levels=2, anchors=(2, 3, 4), dropout=0.0)
AXES = ((0, 1), (1, 2), (0, 2))


def shaken(module: torch.nn.Module) -> torch.nn.Module:
    """The same with its sampling made to depend on queries, as after training."""
    for part in module.modules():
        if isinstance(part, SamplingHead):
            for weight in (part.offsets.weight, part.scores.weight):
                torch.nn.init.normal_(weight, std=0.3)
    return module


def sights_of(batch, anchors=CONFIG.anchors) -> list[ColumnSights]:
    rig = CameraRig.of(batch)
    return [column_sights(anchor_points_m(LATTICE, plane, n), rig, SIZE_PX) for plane, n in enumerate(anchors)]


@pytest.mark.parametrize("plane", range(3))
def test_the_anchors_of_a_cell_lie_in_the_voxels_that_it_stands_for(plane: int) -> None:
    points = anchor_points_m(LATTICE, plane, 5)
    rows, columns = plane_sizes(LATTICE)[plane]
    assert points.shape == (rows * columns, 5, 3)
    indices, is_inside = LATTICE.indices_of(points.flatten(0, 1))
    assert is_inside.all()
    cells = torch.cartesian_prod(torch.arange(rows), torch.arange(columns))[:, None].expand(-1, 5, 2).flatten(0, 1)
    assert torch.equal(indices[:, list(AXES[plane])], cells)


def test_the_outermost_anchors_stand_half_a_metre_from_the_faces() -> None:
    heights = anchor_points_m(LATTICE, 0, 4)[0, :, 2]
    torch.testing.assert_close(heights, torch.tensor([-0.5, -1 / 6, 1 / 6, 0.5]))
    flat = replace(LATTICE, shape=(8, 6, 1))
    torch.testing.assert_close(anchor_points_m(flat, 0, 2)[0, :, 2], torch.tensor([-0.75, -0.75]))


def test_cells_become_maps_whose_rows_and_columns_are_the_planes_axes() -> None:
    cells = torch.cat([points[:, 0] for points in (anchor_points_m(LATTICE, plane, 1) for plane in range(3))])[None]
    for maps, (rows, columns) in zip(as_planes(cells, LATTICE), AXES, strict=True):
        assert (maps[0, rows].diff(dim=0) > 0).all()
        assert not maps[0, rows].diff(dim=1).any()
        assert (maps[0, columns].diff(dim=1) > 0).all()


def test_a_point_is_seen_where_a_pinhole_puts_it() -> None:
    rig = CameraRig.of(frames(torch.zeros(1, 4, 3, *SIZE_PX)))
    x, y, z = CAMERA_M
    pixels, is_ahead = projected(torch.tensor([[[x + 2, y, z], [x - 2, y, z], [x + 2, y + 1, z + 1]]]), rig)
    assert is_ahead[0, 0, 0].tolist() == [True, False, True]
    centre = torch.tensor([(SIZE_PX[1] - 1) / 2, (SIZE_PX[0] - 1) / 2])
    torch.testing.assert_close(pixels[0, 0, 0, 0], centre)
    torch.testing.assert_close(pixels[0, 2, 0, 1], centre)
    moved = pixels[0, 0, 0, 2] - centre
    assert moved[0] < 0, "what is to the left of the robot is left in the picture"
    assert moved[0].item() == pytest.approx(moved[1].item(), rel=1e-4), "a metre left and up of the optical axis"


def test_a_camera_sees_the_columns_of_which_a_point_falls_into_its_picture() -> None:
    batch = frames(torch.zeros(2, 4, 3, *SIZE_PX))
    points = anchor_points_m(LATTICE, 0, 3)
    sights = column_sights(points, CameraRig.of(batch), SIZE_PX)
    pixels, is_ahead = projected(points, CameraRig.of(batch))
    counts = torch.zeros(2, len(points), dtype=torch.int64)
    for frame in range(2):
        for camera in range(4):
            seen = [
                column
                for column in range(len(points))
                if any(
                    ahead and -0.5 < u < SIZE_PX[1] - 0.5 and -0.5 < v < SIZE_PX[0] - 0.5
                    for (u, v), ahead in zip(
                        pixels[frame, camera, column], is_ahead[frame, camera, column], strict=True
                    )
                )
            ]
            assert sights.sights[frame][camera].columns.tolist() == seen
            assert 0 < len(seen) < len(points)
            counts[frame, seen] += 1
    assert torch.equal(sights.cameras, counts)


def test_places_are_shares_of_the_padded_picture_and_never_far_from_it() -> None:
    batch = frames(torch.zeros(1, 4, 3, *SIZE_PX))
    points = anchor_points_m(LATTICE, 2, 8)
    rig = CameraRig.of(batch)
    pixels, is_ahead = projected(points, rig)
    behind = 0
    for sight, where, ahead in zip(column_sights(points, rig, (64, 64)).sights[0], pixels[0], is_ahead[0], strict=True):
        expected = (where[sight.columns] + 0.5) / 64
        near = ahead[sight.columns] & (expected.abs() < 2).all(dim=-1)
        torch.testing.assert_close(sight.places[near], expected[near])
        assert (sight.places[~ahead[sight.columns]] == -2).all()
        assert (sight.places.abs() <= 3).all()
        behind += int((~ahead[sight.columns]).sum())
    assert behind > 0


def test_image_attention_is_the_mean_over_seeing_cameras_of_deformable_attention_around_the_anchors() -> None:
    torch.manual_seed(0)
    attention = shaken(ImageCrossAttention(CONFIG)).double()
    batch = frames(torch.zeros(1, 3, 3, *SIZE_PX))
    sights = sights_of(batch)
    counts = [plane.cameras.shape[1] for plane in sights]
    cells = torch.randn(1, sum(counts), CONFIG.channels, dtype=torch.float64)
    features = [torch.randn(1, 3, CONFIG.channels, *size, dtype=torch.float64) for size in ((4, 6), (2, 3))]
    answer = attention(cells, features, sights)
    queries = cells.split(counts, dim=1)
    for plane, cell in ((0, 13), (1, 5), (2, 30)):
        expected = slow_image_attention(attention, queries[plane][0, cell], features, (sights[plane], plane, cell))
        torch.testing.assert_close(answer[0, sum(counts[:plane]) + cell], expected, rtol=1e-4, atol=1e-4)


def slow_image_attention(attention, query, features, place) -> torch.Tensor:
    sights, plane, cell = place
    offsets, scores = attention.sampling[plane](query)
    heads, levels, anchors = CONFIG.heads, CONFIG.levels, CONFIG.anchors[plane]
    weights = scores.reshape(heads, -1).softmax(dim=1).reshape(1, 1, heads, levels, -1)
    answers = []
    for camera, sight in enumerate(sights.sights[0]):
        for index in (sight.columns == cell).nonzero()[:, 0].tolist():
            places = torch.zeros(1, 1, heads, levels, anchors * CONFIG.points, 2, dtype=torch.float64)
            for level, maps in enumerate(features):
                size = torch.tensor([maps.shape[-1], maps.shape[-2]])
                for anchor in range(anchors):
                    for point in range(CONFIG.points):
                        moved = offsets[:, level * anchors + anchor, point] / size
                        places[0, 0, :, level, anchor * CONFIG.points + point] = sight.places[index, anchor] + moved
            values = [
                attention.values(maps[0, camera].permute(1, 2, 0))
                .permute(2, 0, 1)
                .reshape(1, heads, -1, *maps.shape[-2:])
                for maps in features
            ]
            answers.append(slow_attention(values, places, weights)[0, 0])
    mean = torch.stack(answers).mean(dim=0) if answers else torch.zeros(CONFIG.channels, dtype=torch.float64)
    return query + attention.output(mean)


def test_a_cell_that_no_camera_sees_learns_nothing_from_pictures() -> None:
    torch.manual_seed(0)
    attention = shaken(ImageCrossAttention(CONFIG))
    sights = sights_of(frames(torch.zeros(1, 1, 3, *SIZE_PX)))
    cells = torch.randn(1, sum(plane.cameras.shape[1] for plane in sights), CONFIG.channels)
    features = [torch.randn(1, 1, CONFIG.channels, *size) for size in ((4, 6), (2, 3))]
    is_blind = torch.cat([plane.cameras[0] == 0 for plane in sights])
    changed = (attention(cells, features, sights) - cells).abs().amax(dim=-1)[0] > 1e-6
    assert torch.equal(changed, ~is_blind)
    assert is_blind.any()
    assert not is_blind.all()


def test_hybrid_attention_is_two_deformable_attentions_of_the_plane_to_itself_averaged() -> None:
    torch.manual_seed(0)
    size = (3, 4)
    attention = shaken(CrossViewHybridAttention(CONFIG)).double()
    cells, positions = torch.randn(2, 12, 8, dtype=torch.float64), torch.randn(12, 8, dtype=torch.float64)
    offsets, scores = attention.sampling(torch.cat([cells, cells + positions], dim=-1))
    values = attention.values(cells).transpose(1, 2).reshape(2, CONFIG.heads, 4, *size)
    centres = cell_centres(size, cells.device).double()
    halves = []
    for chosen in range(2):
        places = centres[:, None, None] + offsets[:, :, :, chosen] / torch.tensor([4.0, 3.0], dtype=torch.float64)
        weights = scores[:, :, :, chosen].softmax(dim=-1)
        halves.append(slow_attention([values], places[:, :, :, None], weights[:, :, :, None]))
    expected = cells + attention.output((halves[0] + halves[1]) / 2)
    torch.testing.assert_close(attention(cells, positions, size), expected, rtol=1e-5, atol=1e-5)


def official_logits(aggregator: TPVAggregator, planes: TriPlanes) -> torch.Tensor:
    """As the official code: planes scaled up, added in every voxel, then three linear layers of each voxel."""
    sizes = plane_sizes(aggregator.config.lattice)
    top, front, side = (
        functional.interpolate(maps, size=size, mode="bilinear") for maps, size in zip(planes, sizes, strict=True)
    )
    voxels = (top[:, :, :, :, None] + front[:, :, None] + side[:, :, :, None]).movedim(1, -1)
    hidden = functional.softplus(aggregator.hidden(voxels))
    return aggregator.classifier(aggregator.output(hidden)).movedim(-1, 1)


def test_the_aggregator_is_the_official_one_and_so_are_its_gradients() -> None:
    torch.manual_seed(0)
    lattice = VoxelLattice((0.0, 0.0, 0.0), (0.2, 0.2, 0.2), (20, 6, 4))
    aggregator = TPVAggregator(TPVAggregatorConfig(lattice, channels=5, hidden_channels=7)).double()
    sizes = plane_sizes(lattice.coarser(2))
    planes = TriPlanes(*(torch.randn(2, 5, *size, dtype=torch.float64, requires_grad=True) for size in sizes))
    logits, official = aggregator(planes).double(), official_logits(aggregator, planes)
    assert logits.shape == (2, 4, 20, 6, 4)
    torch.testing.assert_close(logits, official, rtol=1e-5, atol=1e-5)
    parts = [*planes, *aggregator.parameters()]
    probe = torch.randn_like(official)
    ours = torch.autograd.grad((logits * probe).sum(), parts)
    theirs = torch.autograd.grad((official * probe).sum(), parts)
    for mine, wanted in zip(ours, theirs, strict=True):
        torch.testing.assert_close(mine, wanted, rtol=1e-4, atol=1e-4)


torch.set_num_threads(1)
SMALL_TPV = TPVFormerConfig(
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
PICTURE_PX = (48, 80)  # not of multiples of 32


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
    images = torch.randn(size, config.cameras, 3, *PICTURE_PX, generator=generator)
    labels = torch.randint(0, 5, (size, *config.lattice.shape), generator=generator).to(torch.uint8)
    return frames(images, torch.where(labels == 4, 255, labels))


def test_it_has_exactly_the_parameters_of_the_official_modules() -> None:
    with torch.device("meta"):
        model = TPVFormer(TPVFormerConfig())
    assert sum(p.numel() for p in model.parameters()) == 65_070_146
    assert sum(p.numel() for p in model.parameters() if p.requires_grad) == 64_742_402
    assert model.config.plane_lattice().shape == (128, 128, 16)


def test_logits_are_of_every_class_and_voxel() -> None:
    model, batch = model_of(SMALL_TPV).eval(), batch_of(SMALL_TPV)
    logits = model.logits(model(batch), batch)
    assert logits.shape == (2, 4, *SMALL_TPV.lattice.shape)
    assert logits.dtype == torch.float32
    assert logits.isfinite().all()


def test_every_parameter_learns_by_the_losses() -> None:
    model, batch = model_of(SMALL_TPV), batch_of(SMALL_TPV)
    losses = model.losses(model(batch), batch)
    assert set(losses) == {"cross_entropy", "lovasz"}
    torch.stack(list(losses.values())).sum().backward()
    assert [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()] == []


def test_checkpointed_gradients_are_the_same() -> None:
    config = replace(SMALL_TPV, dropout=0.0)
    batch = batch_of(config)
    gradients = []
    for is_checkpointed in (False, True):
        model = model_of(replace(config, checkpoint_gradients=is_checkpointed))
        torch.stack(list(model.losses(model(batch), batch).values())).sum().backward()
        gradients.append([p.grad for p in model.parameters()])
    for plain, checkpointed in zip(*gradients, strict=True):
        torch.testing.assert_close(checkpointed, plain)


def test_a_frame_of_a_batch_is_predicted_as_if_it_were_alone() -> None:
    model, batch = model_of(SMALL_TPV).eval(), batch_of(SMALL_TPV)
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
        config = replace(SMALL_TPV, dropout=0.0)
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
    batch = batch_of(SMALL_TPV)
    with torch.autocast("cpu", torch.bfloat16):
        half = CameraRig.of(batch)
    assert torch.equal(half.pixels_from_grid, CameraRig.of(batch).pixels_from_grid)


def test_it_tells_one_picture_from_another() -> None:
    """Queries of planes alone could remember one frame; of two, trained on together, pictures must say which it is."""
    lattice = VoxelLattice((-3.2, -3.2, -0.8), (0.8, 0.8, 0.8), (8, 8, 4))
    config = replace(SMALL_TPV, lattice=lattice, upscale=1, dropout=0.0, backbone_width=4, layers=1)
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


torch.set_num_threads(1)
BATCH, QUERIES, HEADS, CHANNELS, POINTS = 2, 3, 2, 3, 2
SIZES = ((4, 5), (2, 3))


def inputs_of(seed: int, margin: float = 0.3) -> tuple[list[torch.Tensor], torch.Tensor, torch.Tensor]:
    """Maps, places up to `margin` outside of them, and weights, float64."""
    generator = torch.Generator().manual_seed(seed)
    maps = [torch.randn(BATCH, HEADS, CHANNELS, *size, dtype=torch.float64, generator=generator) for size in SIZES]
    shape = (BATCH, QUERIES, HEADS, len(SIZES), POINTS)
    places = torch.rand(*shape, 2, dtype=torch.float64, generator=generator) * (1 + 2 * margin) - margin
    return maps, places, torch.rand(*shape, dtype=torch.float64, generator=generator)


def bilinear(values: torch.Tensor, place: torch.Tensor) -> torch.Tensor:
    """(c,) of a map (c, rows, columns), pixel by pixel; pixels outside are 0."""
    rows, columns = values.shape[1:]
    u, v = place[0].item() * columns - 0.5, place[1].item() * rows - 0.5
    answer = torch.zeros(len(values), dtype=values.dtype)
    for row in (floor(v), floor(v) + 1):
        for column in (floor(u), floor(u) + 1):
            if 0 <= row < rows and 0 <= column < columns:
                answer = answer + (1 - abs(v - row)) * (1 - abs(u - column)) * values[:, row, column]
    return answer


def slow_attention(maps: list[torch.Tensor], places: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    batch, queries, heads, levels, points = weights.shape
    answer = torch.zeros(batch, queries, heads, maps[0].shape[2], dtype=weights.dtype)
    for at in torch.cartesian_prod(*(torch.arange(n) for n in (batch, queries, heads, levels, points))).tolist():
        frame, query, head, level, _ = at
        answer[frame, query, head] += weights[tuple(at)] * bilinear(maps[level][frame, head], places[tuple(at)])
    return answer.flatten(2)


@pytest.mark.parametrize("seed", range(2))
def test_it_is_the_sum_over_levels_and_points_of_what_bilinear_sampling_finds(seed: int) -> None:
    maps, places, weights = inputs_of(seed)
    torch.testing.assert_close(deformable_attention(maps, places, weights), slow_attention(maps, places, weights))


def test_far_outside_it_finds_nothing() -> None:
    maps, places, weights = inputs_of(2)
    for far in (-2.0, 3.0, 1e30):
        assert not deformable_attention(maps, torch.full_like(places, far), weights).any()


def test_no_queries_have_no_answers_and_yet_a_gradient_of_zeros() -> None:
    maps, places, weights = inputs_of(3)
    maps[0].requires_grad_()
    answer = deformable_attention(maps, places[:, :0], weights[:, :0])
    assert answer.shape == (BATCH, 0, HEADS * CHANNELS)
    answer.sum().backward()
    assert not maps[0].grad.any()


def test_it_computes_in_float32_inside_autocast() -> None:
    maps, places, weights = inputs_of(4)
    narrow = [level.float() for level in maps]
    with torch.autocast("cpu", torch.bfloat16):
        found = deformable_attention(narrow, places.float(), weights.float())
    assert found.dtype == torch.float32
    torch.testing.assert_close(found.double(), slow_attention(maps, places, weights), rtol=1e-4, atol=1e-5)


def test_a_new_head_looks_along_a_ring_with_equal_scores_whatever_it_is_asked() -> None:
    heads, groups, points = 8, 3, 4
    sampling = SamplingHead(16, (heads, groups, points))
    offsets, scores = sampling(torch.randn(5, 16))
    assert not scores.any()
    torch.testing.assert_close(offsets.abs().amax(dim=-1), torch.arange(1.0, 5.0).expand(5, heads, groups, points))
    torch.testing.assert_close(
        offsets[:, 2], torch.tensor([0.0, 1.0]) * torch.arange(1.0, 5.0)[:, None].expand(5, 3, 4, 1)
    )
    torch.testing.assert_close(offsets[0].sum(dim=0), torch.zeros(groups, points, 2), atol=1e-5, rtol=0)


def test_heads_are_consecutive_channels() -> None:
    values = torch.arange(6.0)[:, None, None].expand(6, 2, 2)
    assert by_head(values, 3)[:, :, 0, 0].tolist() == [[0, 1], [2, 3], [4, 5]]
