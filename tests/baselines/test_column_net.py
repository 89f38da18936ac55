"""ColumnNet: it answers from any sensors, knows what it does not know; its columns against loops over points."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from baselines.batch import Batch, Points
from baselines.lattice import VoxelLattice
from baselines.layers.terrain_columns import (
    ColumnAlignment,
    TerrainColumns,
    column_hits,
    evidence_of,
    filled,
    radar_maps,
    reference_of,
    statistics_of,
    surface_of,
)
from baselines.models.column_net import ColumnNet, ColumnOutputs, hard_voxels
from baselines.models.column_net_config import ColumnNetConfig
from stone_base.label_grid import PAPER
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
    assert model.lattice.is_whole(PAPER)
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


LATTICE = VoxelLattice((-1.6, -1.6, -0.8), (0.2, 0.2, 0.2), (16, 16, 12))
ALIGNMENT = ColumnAlignment(LATTICE, heights=10, below=3)


def scattered(points: int = 400, frames: int = 2, features: int = 5) -> Points:
    generator = torch.Generator().manual_seed(0)
    rows = torch.rand(points, features, generator=generator)
    rows[:, :3] = rows[:, :3] * 4 - torch.tensor([2.0, 2.0, 1.0])
    rows[:, :2] = rows[:, :2] / 3  # several in a column
    return Points(rows, (torch.arange(points) * frames) // points)


def tilted(frames: int = 2) -> TerrainColumns:
    slope = LATTICE.centres_m()[:, :, 0, 0] * 0.4 + 0.03
    return ALIGNMENT.terrain(slope.expand(frames, 1, -1, -1))


def of_columns(points: Points) -> dict[tuple[int, int, int], Tensor]:
    """Rows of the points in the lattice, by frame and column."""
    index, is_inside = LATTICE.indices_of(points.features[:, :3])
    found: dict[tuple[int, int, int], list[Tensor]] = {}
    for row, place, frame, is_in in zip(points.features, index.tolist(), points.frame.tolist(), is_inside, strict=True):
        if is_in:
            found.setdefault((frame, place[0], place[1]), []).append(row)
    return {key: torch.stack(rows) for key, rows in found.items()}


def test_evidence_is_what_a_loop_over_points_counts() -> None:
    points, terrain = scattered(), tilted()
    maps = evidence_of(column_hits(points, LATTICE), terrain, ALIGNMENT, newest_s=0.2).reshape(2, 3, 10, 16, 16)
    slow = torch.zeros_like(maps)
    for (frame, x, y), rows in of_columns(points).items():
        place = (rows[:, 2] + 0.8) / 0.2
        for height in range(10):
            here = rows[place.floor() == height + int(terrain.base[frame, x, y])]
            if len(here):
                within = (here[:, 2] + 0.8) / 0.2 - (height + int(terrain.base[frame, x, y])) - 0.5
                newest = float((here[:, 4] <= 0.2).any())
                slow[frame, :, height, x, y] = torch.tensor(
                    [float(torch.log(torch.tensor(1.0 + len(here)))) / 3, newest, float(within.mean())]
                )
    assert (slow[:, 0] > 0).sum() > 100
    torch.testing.assert_close(maps, slow, atol=1e-5, rtol=1e-4)


def test_statistics_are_those_of_each_columns_points() -> None:
    points, terrain = scattered(), tilted()
    maps = statistics_of(column_hits(points, LATTICE), terrain, LATTICE)
    slow = torch.zeros(2, 7, 16, 16)
    for (frame, x, y), rows in of_columns(points).items():
        above = rows[:, 2] - terrain.reference_m[frame, 0, x, y]
        count = torch.tensor(1.0 + len(rows)).log() / 3
        slow[frame, :, x, y] = torch.stack(
            [torch.ones(()), count, above.min(), above.max(), above.mean(), above.std(correction=0), rows[:, 3].mean()]
        )
    torch.testing.assert_close(maps[:, :7], slow, atol=1e-3, rtol=1e-4)
    torch.testing.assert_close(maps[:, 9, 1:-1], torch.full((2, 14, 16), 0.4), atol=1e-4, rtol=0)
    assert (maps[:, 10].abs() < 1e-5).all()
    assert torch.equal(maps[:, 7], terrain.reference_m[:, 0])
    assert (maps[:, 8].abs() <= 0.5).all()


def test_radar_maps_are_means_of_each_columns_points() -> None:
    points, terrain = scattered(features=7), tilted()
    maps = radar_maps(column_hits(points, LATTICE), terrain)
    for (frame, x, y), rows in of_columns(points).items():
        above = rows[:, 2].mean() - terrain.reference_m[frame, 0, x, y]
        slow = torch.stack([torch.tensor(1.0 + len(rows)).log(), above, *rows[:, 3:6].mean(dim=0)])
        torch.testing.assert_close(maps[frame, :, x, y], slow, atol=1e-5, rtol=1e-4)


def test_a_surface_is_the_lowest_and_highest_point_and_the_terrain_between() -> None:
    points, terrain = scattered(), tilted()
    surface = surface_of(column_hits(points, LATTICE), terrain, 0.8)
    columns = of_columns(points)
    for (frame, x, y), rows in columns.items():
        assert surface[frame, 0, x, y] == rows[:, 2].min()
        assert surface[frame, 1, x, y] == rows[:, 2].max()
    is_empty = torch.ones(2, 16, 16, dtype=torch.bool)
    for frame, x, y in columns:
        is_empty[frame, x, y] = False
    torch.testing.assert_close(surface[:, 0][is_empty], terrain.reference_m[:, 0][is_empty])
    torch.testing.assert_close(surface[:, 1][is_empty], terrain.reference_m[:, 0][is_empty] + 0.8)


def plane(slope: float, above_m: float) -> Points:
    centres = LATTICE.centres_m()[::3, ::5, 0].reshape(-1, 3)
    rows = torch.cat([centres, torch.zeros(len(centres), 2)], dim=1)
    rows[:, 2] = slope * rows[:, 0] + above_m
    return Points(rows, torch.zeros(len(rows), dtype=torch.int64))


def test_the_reference_of_sparsely_hit_flat_ground_is_that_ground() -> None:
    reference = reference_of(column_hits(plane(0.0, 0.31), LATTICE), 1, LATTICE)
    torch.testing.assert_close(reference, torch.full((1, 1, 16, 16), 0.31))


def test_the_reference_of_a_slope_rises_with_it() -> None:
    reference = reference_of(column_hits(plane(0.3, 0.0), LATTICE), 1, LATTICE)[0, 0]
    truth = 0.3 * LATTICE.centres_m()[:, :, 0, 0]
    assert (reference[4:-4] - truth[4:-4]).abs().max() < 0.3 * 4 * 0.2
    assert reference[-1].mean() - reference[0].mean() > 0.2


def test_what_is_known_stays_and_holes_take_what_is_near() -> None:
    values = torch.zeros(1, 1, 8, 8)
    values[..., 4:] = 2.0
    weights = torch.zeros(1, 1, 8, 8)
    weights[..., ::3, ::3] = 1.0
    whole = filled(values * weights, weights)
    assert torch.equal(whole[weights > 0], values[weights > 0])
    assert ((whole >= 0) & (whole <= 2)).all()
    assert whole[0, 0, 1, 7] > 1 > whole[0, 0, 1, 1]
