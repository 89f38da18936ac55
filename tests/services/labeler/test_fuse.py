"""Fusing by parts: the files of all parts together are the map of the run, however it was divided or driven, and come
back bit for bit; the plan names, before a sweep is read, every part that can leave anything in a tile's cube."""

from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.labeler.map.fuse import fuse
from services.labeler.map.fused_files import fused_columns, fused_observed, fused_points
from services.labeler.parameters import LabelParameters, TilingParameters, parameters_for
from services.labeler.process_pool import Task, Workers
from services.labeler.run import LabelRun, Part, Tile, neighbourhood, parts_of
from services.labeler.scratch import images_near, images_path, load_observed, load_points, save_images, tile_named
from services.labeler.tile_plan import plan_of, reach_m, tiles_around
from stone.geometry.lattice import indices_of, keys_from_indices
from stone.geometry.se3 import SE3
from stone.labels.observed_voxels import NOTHING, Observed, union
from stone.sensors.calibration import Box
from stone.sensors.sequence import Frames, Sweep
from stone.surface.pointmap import PointMap, merge
from tests.observed_voxels import voxel_keys
from tests.services.labeler.worlds import RayCast, World, sequence_of

WORLD = World(
    grade=(0.04, -0.02),
    boxes=(Box((1.0, 2.0, 0.0), (2.0, 3.0, 1.5)),),
    map_from_world=(1.0, 0, 0, 0, 0.3, -0.7, 0),  # over the corner of four tiles
    frames=10,
    step_m=1.1,
)
EVERYWHERE = (np.full(2, -1000.0), np.full(2, 1000.0))


def run_in(folder, frames_per_part, sequence=None, sweeps=None):
    parameters = LabelParameters(tiling=TilingParameters(frames_per_part=frames_per_part))
    return LabelRun(sequence or sequence_of(WORLD), sweeps or RayCast(WORLD), parameters, folder)


def fused(run):
    """The whole point map, what was observed, and how many points were fused."""
    points = sum(fuse(run, part) for part in reversed(parts_of(run)))
    tiles = [tile_named(folder.name) for folder in (run.scratch / "fused").iterdir()]
    maps = [part for tile in tiles for part in load_points(run, tile, *EVERYWHERE)]
    return merge(maps), union([load_observed(run, tile) for tile in tiles]), points, len(tiles)


@pytest.mark.parametrize("frames_per_part", [1, 3, 7])
def test_any_division_into_parts_gives_the_same_bits(tmp_path, frames_per_part):
    whole, whole_observed, points, tiles = fused(run_in(tmp_path / "whole", 10))
    parts, parts_observed, added, _ = fused(run_in(tmp_path / "parts", frames_per_part))
    assert tiles == 4
    assert points == added == whole.counts().sum()
    assert parts.keys.tobytes() == whole.keys.tobytes()
    assert parts.moments.tobytes() == whole.moments.tobytes()
    assert parts_observed.keys.tobytes() == whole_observed.keys.tobytes()
    assert parts_observed.words.tobytes() == whole_observed.words.tobytes()


@dataclass(frozen=True)
class Again:
    """The same drive a second time, begun where the first one ended."""

    frames: int

    def sweep(self, index: int) -> Sweep:
        return RayCast(WORLD).sweep(index % self.frames)


def test_a_place_driven_twice_has_the_voxels_of_one_pass_and_the_points_of_both(tmp_path):
    once = sequence_of(WORLD)
    poses = once.frames.map_from_ego
    twice = np.concatenate([np.arange(len(poses))] * 2)
    stamps_ns = once.frames.stamps_ns[twice] + np.repeat([0, 3_600_000_000_000], len(poses))
    frames = Frames(stamps_ns, tuple(f"{row:032x}" for row in range(len(twice))), poses[twice])
    one, one_observed, points, _ = fused(run_in(tmp_path / "once", 4))
    both, both_observed, added, _ = fused(
        run_in(tmp_path / "twice", 4, replace(once, frames=frames), Again(len(poses)))
    )
    assert added == 2 * points
    assert both.keys.tobytes() == one.keys.tobytes()
    assert (both.moments == 2 * one.moments).all()
    assert voxel_keys(both_observed).tobytes() == voxel_keys(one_observed).tobytes()


LONG = World(frames=14, step_m=6.0)
BY_FOUR = LabelParameters(tiling=TilingParameters(frames_per_part=4))


def looking_run(folder, every_frame=3):
    dynamic = replace(BY_FOUR.dynamic, every_frame=every_frame, max_range_m=20.0)
    return LabelRun(sequence_of(LONG), RayCast(LONG), replace(BY_FOUR, dynamic=dynamic), folder)


def gap_m(place, low, high):
    """From the place to the box, axis by axis."""
    return sum(max(a - p, p - b, 0.0) ** 2 for p, a, b in zip(place, low, high, strict=True)) ** 0.5


@pytest.mark.parametrize("every_frame", [1, 3, 5])
def test_a_tile_looks_at_every_image_taken_within_reach_of_it(tmp_path, every_frame):
    run = looking_run(tmp_path, every_frame)
    for begin in range(0, 14, 4):
        fuse(run, (begin, min(begin + 4, 14)))
    low, high = np.array([10.0, 20.0, -1.0]), np.array([14.0, 30.0, 2.0])
    places = [run.sequence.frames.map_from_ego[index] @ run.sensor_ego for index in range(0, 14, every_frame)]
    near = [place for place in places if gap_m(place, low, high) < 20.0]
    assert 0 < len(near) < len(places)
    images = list(chain.from_iterable(images_near(run, 0, low, high)))
    np.testing.assert_array_equal([image.map_from_view.translation_m for image in images], near)
    assert all((image.ranges_m > 0).any() for image in images)


def test_an_image_is_read_as_it_was_taken_though_rows_that_saw_nothing_are_not_kept(tmp_path):
    run = looking_run(tmp_path, 1)
    taken = {index: np.zeros(run.parameters.dynamic.shape, np.float32) for index in (0, 1)}
    taken[0][20:40, 7], taken[1][30:50] = 5.0, 6.0
    save_images(run, (0, 4), {**taken, 2: taken[0], 3: taken[1]})
    place = run.sequence.frames.map_from_ego[0] @ run.sensor_ego
    near = list(chain.from_iterable(images_near(run, 0, place, place)))
    for image, index in zip(near, (0, 1), strict=False):
        assert image.ranges_m.tobytes() == taken[index].tobytes()
    assert images_path(run, (0, 4)).stat().st_size < 4 * 30 * taken[0][0].nbytes + 2000


def test_a_tile_looks_at_no_part_that_is_out_of_its_reach(tmp_path):
    """Which parts happen to be fused already, or not yet, changes nothing."""
    run = looking_run(tmp_path)
    low, high = np.array([58.0, 20.0, -1.0]), np.array([68.0, 30.0, 2.0])
    for begin in (8, 12):
        fuse(run, (begin, min(begin + 4, 14)))
    early = [image.ranges_m for images in images_near(run, 0, low, high) for image in images]
    for begin in (0, 4):
        fuse(run, (begin, begin + 4))
    late = [image.ranges_m for images in images_near(run, 0, low, high) for image in images]
    assert len(early) == len(late) == 2
    assert all((a == b).all() for a, b in zip(early, late, strict=True))


def test_an_image_that_is_not_there_yet_is_not_passed_over(tmp_path):
    run = looking_run(tmp_path)
    with pytest.raises(FileNotFoundError, match=images_path(run, (0, 4)).name):
        list(images_near(run, 0, np.array([-20.0, 20.0, -1.0]), np.array([-10.0, 30.0, 2.0])))


TORN, LONG_STEP_M = World(), 9.0


def driven(tmp_path: Path, parts_of: int) -> LabelRun:
    """The drive of a small world, its frames torn so far apart that they lie in several tiles."""
    sequence = sequence_of(TORN)
    poses = sequence.frames.map_from_ego.wxyz_xyz.copy()
    poses[:, 4:6] += LONG_STEP_M * np.arange(len(poses))[:, None] * (1.0, 0.5)
    frames = replace(sequence.frames, map_from_ego=SE3(poses))
    parameters = parameters_for("paper")
    parameters = replace(parameters, tiling=replace(parameters.tiling, frames_per_part=parts_of))
    return LabelRun(replace(sequence, frames=frames), RayCast(TORN), parameters, tmp_path)


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> LabelRun:
    run = driven(tmp_path_factory.mktemp("run"), 4)
    for part in plan_of(run).parts:
        fuse(run, part)
    return run


def parts_left(run: LabelRun) -> dict[Tile, set[int]]:
    """Which parts left a file in which tile."""
    folders = (run.scratch / "fused").iterdir()
    return {tile_named(folder.name): {int(path.stem) for path in folder.iterdir()} for folder in folders}


def test_whatever_a_part_left_in_a_tile_was_planned(planned: LabelRun) -> None:
    plan = plan_of(planned)
    left = parts_left(planned)
    assert len(left) > 3
    for tile, parts in left.items():
        assert parts <= {part[0] for part in plan.needs[tile]}


def test_a_tile_waits_for_every_part_with_a_point_in_its_cube_and_not_for_all(planned: LabelRun) -> None:
    plan, tiling = plan_of(planned), planned.parameters.tiling
    for tile, parts in plan.needs.items():
        low = tile.place * planned.parameters.core_m - tiling.halo_m
        high = low + planned.parameters.core_m + 2 * tiling.halo_m
        every = sum(len(one) for near in neighbourhood(tile) for one in load_points(planned, near, low, high))
        assert every == sum(_points_of(planned, tile, part) for part in parts)
    assert any(len(parts) < len(plan.parts) for parts in plan.needs.values())


def _points_of(run: LabelRun, tile: Tile, part: Part) -> int:
    """What this part alone left in the cube."""
    alone = replace(run, scratch=run.scratch.with_name(f"alone-{part[0]}"))
    if not alone.scratch.exists():
        fuse(alone, part)
    low = tile.place * run.parameters.core_m - run.parameters.tiling.halo_m
    high = low + run.parameters.core_m + 2 * run.parameters.tiling.halo_m
    return sum(len(one) for near in neighbourhood(tile) for one in load_points(alone, near, low, high))


def test_tiles_come_in_the_order_in_which_they_can_be_begun(planned: LabelRun) -> None:
    last = [parts[-1] for parts in plan_of(planned).needs.values()]
    assert last == sorted(last)


def test_the_plan_does_not_depend_on_what_is_on_disk(planned: LabelRun, tmp_path: Path) -> None:
    assert plan_of(replace(planned, scratch=tmp_path)) == plan_of(planned)


def test_frames_look_only_at_planned_tiles_or_empty_ones(planned: LabelRun) -> None:
    left = parts_left(planned)
    for part in plan_of(planned).parts:
        assert set(tiles_around(planned, part)) & left.keys()


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
    with Workers(1) as workers, pytest.raises(ValueError, match=r"1 tasks wait for results .*orphan"):
        list(workers.run(tasks))


def map_of(seed, count, reach, largest):
    rng = np.random.default_rng(seed)
    keys = np.unique(keys_from_indices(rng.integers(-reach, reach + 1, (count, 3))))
    moments = rng.integers(-largest, largest, (len(keys), 8), dtype=np.int64)
    moments[:, :2] = np.abs(moments[:, :2]) + 1
    return PointMap(0.1, keys, moments)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32), st.integers(0, 60), st.sampled_from([0, 3, 500, 2**20 - 2]), st.integers(1, 2**62))
def test_a_point_map_comes_back_bit_for_bit(seed, count, reach, largest):
    points = map_of(seed, count, reach, largest)
    read = fused_points(fused_columns(points, NOTHING), 0.1)
    assert read.keys.tobytes() == points.keys.tobytes()
    assert read.moments.tobytes() == points.moments.tobytes()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32), st.integers(0, 200), st.sampled_from([3, 9, 2**20 - 2]), st.data())
def test_a_rectangle_of_a_point_map_is_its_voxels_there(seed, count, reach, data):
    points, index = map_of(seed, count, reach, 1000), st.integers(-reach - 2, reach + 2)
    low, high = np.sort([data.draw(st.tuples(index, index)) for _ in range(2)], axis=0)
    read = fused_points(fused_columns(points, NOTHING), 0.1, (low, high))
    places = indices_of(points.keys)[:, :2]
    inside = points.where(((low <= places) & (places < high)).all(axis=1))
    assert read.keys.tobytes() == inside.keys.tobytes()
    assert read.moments.tobytes() == inside.moments.tobytes()


@given(st.sets(st.integers(0, 2**62), max_size=40))
def test_what_was_observed_comes_back_bit_for_bit(keys):
    words, since = np.arange(len(keys), dtype=np.uint64) << np.uint64(57), np.arange(len(keys), dtype=np.int32) * 9000
    observed = Observed(np.array(sorted(keys), np.int64), words, since)
    read = fused_observed(fused_columns(map_of(1, 0, 1, 1), observed))
    assert read.keys.tobytes() == observed.keys.tobytes()
    assert read.words.tobytes() == observed.words.tobytes()
    assert read.since.tobytes() == observed.since.tobytes()


@pytest.mark.parametrize(("largest", "width"), [(100, 1), (30_000, 2), (2**30, 4), (2**40, 8)])
def test_sums_take_no_more_bytes_than_they_need(largest, width):
    columns = fused_columns(map_of(2, 500, 200, largest), NOTHING)
    assert columns["offsets"].dtype == columns["views"].dtype == np.dtype(f"i{width}")
