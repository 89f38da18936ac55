"""Votes of frames for the classes of map voxels, against counting them one by one."""

from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.labeler.imports.fused_labels import TILE_VOXELS, FusedLabels
from services.labeler.imports.votes import VoteBricks
from services.labeler.run import Tile
from stone.geometry.lattice import indices_of, keys_from_indices
from stone.geometry.se3 import SE3
from stone.labels.grid import GRID_MIN_M, GRID_SHAPE, Grid
from stone.labels.voxels import VOXEL_M
from stone_datasets.file_faults import MapTooDenseError

Votes = dict[tuple[int, int, int], Counter[int]]


def grid_of(seed: int, count: int = 400) -> Grid:
    """So many occupied voxels of all classes, some in one place."""
    random, grid = np.random.default_rng(seed), np.zeros(GRID_SHAPE, np.uint8)
    places = random.integers(0, GRID_SHAPE, (count, 3))
    places[: count // 2] %= (12, 12, 12)
    grid[tuple(places.T)] = random.integers(1, 4, count)
    return grid


def counted(grids: list[tuple[Grid, SE3]]) -> Votes:
    """What each map voxel is voted for, a voxel of a frame at a time."""
    votes: Votes = {}
    for grid, pose in grids:
        for place in np.argwhere(grid):
            centre_ego = (place + 0.5) * VOXEL_M + np.array(GRID_MIN_M)
            centre_map = pose.rotation() @ centre_ego + pose.translation_m
            index = tuple(np.floor(centre_map / VOXEL_M).astype(int).tolist())
            votes.setdefault(index, Counter())[int(grid[tuple(place)])] += 1
    return votes


def elected(votes: Votes) -> dict[tuple[int, int, int], int]:
    """Most votes; of equal ones N, then P."""
    return {index: max((3, 2, 1), key=lambda kind: (of[kind], kind)) for index, of in votes.items()}


@st.composite
def poses(draw: st.DrawFn) -> SE3:
    numbers = [draw(st.floats(-1, 1)) for _ in range(3)]
    place = [draw(st.floats(-300, 300)) for _ in range(3)]
    return SE3.from_parts(np.array([1.2, *numbers]), np.array(place) + np.pi / 100)


def fused(grids: list[tuple[Grid, SE3]], bricks: VoteBricks) -> dict[tuple[int, int, int], int]:
    with TemporaryDirectory() as folder:
        labels, found = FusedLabels("meadow", Path(folder) / "votes", bricks), {}
        for grid, pose in grids:
            labels.add(grid, pose)
        for tile, keys, classes in labels.tiles():
            indices = indices_of(keys)
            assert (np.diff(keys) > 0).all()
            assert (indices[:, :2] // TILE_VOXELS == (tile.i, tile.j)).all()
            found |= dict(zip(map(tuple, indices.tolist()), classes.tolist(), strict=True))
    return found


@given(st.lists(st.tuples(st.integers(0, 2**31), poses()), min_size=1, max_size=3), st.sampled_from([64, 256, 16384]))
@settings(max_examples=12, deadline=None)
def test_every_voxel_has_the_class_of_most_votes_however_few_bricks_there_are(
    drawn: list[tuple[int, SE3]], bricks: int
) -> None:
    """Catches alone a kernel, a spill or a merge that loses, repeats or misplaces votes."""
    grids = [(grid_of(seed), pose) for seed, pose in drawn for _ in range(2)]
    assert fused(grids, VoteBricks(bricks)) == elected(counted(grids))


def test_of_equal_votes_the_more_cautious_class_wins() -> None:
    at_rest, grids = SE3(np.array([1.0, 0, 0, 0, 0.1, 0.1, 0.1])), []
    for kinds in ((1, 1, 2, 1), (2, 3, 3, 1)):
        grid = np.zeros(GRID_SHAPE, np.uint8)
        grid[128, 128, 10:14] = kinds
        grids.append((grid, at_rest))
    found = fused(grids, VoteBricks())
    assert [found[index] for index in sorted(found)] == [2, 3, 3, 1]


def test_a_frame_in_line_with_the_map_is_the_map() -> None:
    grid = grid_of(3)
    found = fused([(grid, SE3(np.array([1.0, 0, 0, 0, 20.0, -30.0, 4.0])))], VoteBricks())
    places = np.argwhere(grid)
    low = np.round(np.add(GRID_MIN_M, (20.0, -30.0, 4.0)) / VOXEL_M).astype(int)
    assert found == dict(zip(map(tuple, (places + low).tolist()), grid[tuple(places.T)].tolist(), strict=True))


def test_counts_are_told_apart_where_many_frames_vote_for_one_voxel() -> None:
    bricks, grid, at_rest = VoteBricks(64), np.zeros(GRID_SHAPE, np.uint8), SE3.identity()
    for kind, times in ((1, 300), (2, 70), (3, 5)):
        grid[128, 128, 10] = kind
        for _ in range(times):
            assert bricks.vote(grid, at_rest) == -1
    (((i, j), votes),) = bricks.emptied(30)
    assert (i, j) == (0, 0)
    assert votes.counts.tolist() == [[300, 70, 5]]
    assert indices_of(votes.keys).tolist() == [[0, 0, 0]]
    assert list(bricks.emptied(30)) == []


def test_labels_that_fill_a_tile_without_end_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.labeler.imports.fused_labels.MOST_TILE_VOXELS", 50)
    labels = FusedLabels("meadow", tmp_path / "votes")
    labels.add(grid_of(1), SE3.identity())
    with pytest.raises(MapTooDenseError, match="meadow occupy"):
        list(labels.tiles())


def test_votes_of_a_tile_are_put_together_before_its_file_grows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("services.labeler.imports.fused_labels.LEAST_RECORDS", 100)
    labels, grid = FusedLabels("meadow", tmp_path / "votes", VoteBricks(64)), np.zeros(GRID_SHAPE, np.uint8)
    grid[130:150, 130:150, 10] = 2
    largest = 0
    for _ in range(40):
        labels.add(grid, SE3.identity())
        labels._spill()
        largest = max(largest, *(path.stat().st_size for path in (tmp_path / "votes").iterdir()))
    assert largest <= 3 * 400 * 20
    ((tile, keys, classes),) = labels.tiles()
    assert tile == Tile(0, 0)
    assert np.array_equal(np.sort(keys_from_indices(np.argwhere(grid) - (128, 128, 10))), keys)
    assert (classes == 2).all()
