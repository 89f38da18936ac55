"""The parts of TPVFormer: planes and anchors, what cameras see, its attentions and its aggregator."""

from dataclasses import replace

import pytest
import torch
from torch.nn import functional

from baselines.lattice import VoxelLattice
from baselines.layers.deformable_attention import SamplingHead
from baselines.layers.tpv.aggregator import TPVAggregator, TPVAggregatorConfig
from baselines.layers.tpv.attention import (
    CrossViewHybridAttention,
    ImageCrossAttention,
    PlaneAttentionConfig,
    cell_centres,
)
from baselines.layers.tpv.camera_sight import CameraRig, ColumnSights, column_sights, projected
from baselines.layers.tpv.planes import TriPlanes, anchor_points_m, as_planes, plane_sizes
from tests.baselines.camera_frames import frames
from tests.baselines.camera_scene import CAMERA_M
from tests.baselines.test_deformable_attention import slow_attention

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


def test_mirroring_the_grid_moves_points_and_not_what_pictures_show() -> None:
    batch = frames(torch.zeros(1, 4, 3, *SIZE_PX))
    points = torch.randn(20, 2, 3, generator=torch.Generator().manual_seed(0)) * 3
    flip = torch.diag(torch.tensor([1.0, -1.0, 1.0, 1.0]))
    mirrored = replace(batch, grid_from_ego=flip.expand(1, 4, 4))
    there, is_ahead = projected(points @ flip[:3, :3], CameraRig.of(mirrored))
    here, was_ahead = projected(points, CameraRig.of(batch))
    assert torch.equal(is_ahead, was_ahead)
    torch.testing.assert_close(there[is_ahead], here[is_ahead], rtol=1e-3, atol=1e-2)


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
