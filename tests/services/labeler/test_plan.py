"""The plan names, before a sweep is read, every part that can leave anything in a tile's cube."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from services.labeler.map.fuse import fuse
from services.labeler.parameters import parameters_for
from services.labeler.plan import plan_of, reach_m, tiles_around
from services.labeler.run import LabelRun, Part, Tile, neighbourhood
from services.labeler.scratch import load_points, tile_named
from services.labeler.workers import Task, Workers
from stone.geometry.se3 import SE3
from tests.services.labeler.worlds import RayCast, World, sequence_of

WORLD, LONG_STEP_M = World(), 9.0


def driven(tmp_path: Path, parts_of: int) -> LabelRun:
    """The drive of a small world, its frames torn so far apart that they lie in several tiles."""
    sequence = sequence_of(WORLD)
    poses = sequence.frames.map_from_ego.wxyz_xyz.copy()
    poses[:, 4:6] += LONG_STEP_M * np.arange(len(poses))[:, None] * (1.0, 0.5)
    frames = replace(sequence.frames, map_from_ego=SE3(poses))
    parameters = parameters_for("paper")
    parameters = replace(parameters, tiling=replace(parameters.tiling, frames_per_part=parts_of))
    return LabelRun(replace(sequence, frames=frames), RayCast(WORLD), parameters, tmp_path)


@pytest.fixture(scope="module")
def fused(tmp_path_factory: pytest.TempPathFactory) -> LabelRun:
    run = driven(tmp_path_factory.mktemp("run"), 4)
    for part in plan_of(run).parts:
        fuse(run, part)
    return run


def found(run: LabelRun) -> dict[Tile, set[int]]:
    """Which parts left a file in which tile."""
    folders = (run.scratch / "fused").iterdir()
    return {tile_named(folder.name): {int(path.stem) for path in folder.iterdir()} for folder in folders}


def test_whatever_a_part_left_in_a_tile_was_planned(fused: LabelRun) -> None:
    plan = plan_of(fused)
    left = found(fused)
    assert len(left) > 3
    for tile, parts in left.items():
        assert parts <= {part[0] for part in plan.needs[tile]}


def test_a_tile_waits_for_every_part_with_a_point_in_its_cube_and_not_for_all(fused: LabelRun) -> None:
    plan, tiling = plan_of(fused), fused.parameters.tiling
    for tile, parts in plan.needs.items():
        low = tile.place * fused.parameters.core_m - tiling.halo_m
        high = low + fused.parameters.core_m + 2 * tiling.halo_m
        every = sum(len(one) for near in neighbourhood(tile) for one in load_points(fused, near, low, high))
        assert every == sum(_points_of(fused, tile, part) for part in parts)
    assert any(len(parts) < len(plan.parts) for parts in plan.needs.values())


def _points_of(run: LabelRun, tile: Tile, part: Part) -> int:
    """What this part alone left in the cube."""
    alone = replace(run, scratch=run.scratch.with_name(f"alone-{part[0]}"))
    if not alone.scratch.exists():
        fuse(alone, part)
    low = tile.place * run.parameters.core_m - run.parameters.tiling.halo_m
    high = low + run.parameters.core_m + 2 * run.parameters.tiling.halo_m
    return sum(len(one) for near in neighbourhood(tile) for one in load_points(alone, near, low, high))


def test_tiles_come_in_the_order_in_which_they_can_be_begun(fused: LabelRun) -> None:
    last = [parts[-1] for parts in plan_of(fused).needs.values()]
    assert last == sorted(last)


def test_the_plan_does_not_depend_on_what_is_on_disk(fused: LabelRun, tmp_path: Path) -> None:
    assert plan_of(replace(fused, scratch=tmp_path)) == plan_of(fused)


def test_frames_look_only_at_planned_tiles_or_empty_ones(fused: LabelRun) -> None:
    left = found(fused)
    for part in plan_of(fused).parts:
        assert set(tiles_around(fused, part)) & left.keys()


def test_reach_covers_the_rays_and_the_corner_of_the_labelled_box() -> None:
    parameters = parameters_for("paper")
    assert reach_m(parameters, np.array([0.0, 0.0, 1.0])) > 41.0
    narrow = replace(parameters, carve=replace(parameters.carve, max_range_m=1.0))
    narrow = replace(narrow, dynamic=replace(narrow.dynamic, max_range_m=1.0))
    assert reach_m(narrow, np.zeros(3)) > float(np.hypot(26.6, 26.6))


def add(left: int, right: int) -> int:
    return left + right


def test_tasks_that_wait_for_each_other_are_done_in_order_of_their_needs() -> None:
    tasks = [
        Task(("last",), add, (3, 4), frozenset({("a", 1), ("b", 1)})),
        Task(("b", 1), add, (2, 2), frozenset({("a", 1)})),
        Task(("a", 1), add, (1, 1)),
        Task(("free", 1), add, (5, 5)),
    ]
    with Workers(2) as workers:
        done = [(task.key, result.value) for task, result in workers.run(tasks)]
    order = [key for key, _ in done]
    assert dict(done) == {("a", 1): 2, ("b", 1): 4, ("last",): 7, ("free", 1): 10}
    assert order.index(("a", 1)) < order.index(("b", 1)) < order.index(("last",))


def test_a_task_that_waits_for_nobody_is_refused() -> None:
    tasks = [Task(("orphan",), add, (1, 1), frozenset({("nobody",)}))]
    with Workers(1) as workers, pytest.raises(ValueError, match=r"1 tasks wait for what nobody does.*orphan"):
        list(workers.run(tasks))
