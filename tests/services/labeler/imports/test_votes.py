"""Votes of frames for the classes of map voxels, counts of labels, and the faces of voxels: against counting them one
by one, with numpy, and by looking at the six neighbours of each."""

from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.labeler.imports.fused_labels import TILE_VOXELS, FusedLabels, VoteBricks
from services.labeler.imports.label_counts import class_counts, set_count
from services.labeler.imports.map_products import CORNERS, coarser, exposed_faces, few_faces
from services.labeler.run import Tile
from stone.geometry.lattice import indices_of, keys_from_indices
from stone.geometry.se3 import SE3
from stone.labels.grid import Grid
from stone.labels.voxels import VOXEL_M
from stone_base.label_grid import PAPER
from testing.refusals import refused_as

Votes = dict[tuple[int, int, int], Counter[int]]


def grid_of(seed: int, count: int = 400) -> Grid:
    """So many occupied voxels of all classes, some in one place."""
    random, grid = np.random.default_rng(seed), np.zeros(PAPER.shape, np.uint8)
    places = random.integers(0, PAPER.shape, (count, 3))
    places[: count // 2] %= (12, 12, 12)
    grid[tuple(places.T)] = random.integers(1, 4, count)
    return grid


def counted(grids: list[tuple[Grid, SE3]]) -> Votes:
    """What each map voxel is voted for, a voxel of a frame at a time."""
    votes: Votes = {}
    for grid, pose in grids:
        for place in np.argwhere(grid):
            centre_ego = (place + 0.5) * VOXEL_M + np.array(PAPER.min_m)
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
        grid = np.zeros(PAPER.shape, np.uint8)
        grid[128, 128, 10:14] = kinds
        grids.append((grid, at_rest))
    found = fused(grids, VoteBricks())
    assert [found[index] for index in sorted(found)] == [2, 3, 3, 1]


def test_a_frame_in_line_with_the_map_is_the_map() -> None:
    grid = grid_of(3)
    found = fused([(grid, SE3(np.array([1.0, 0, 0, 0, 20.0, -30.0, 4.0])))], VoteBricks())
    places = np.argwhere(grid)
    low = np.round(np.add(PAPER.min_m, (20.0, -30.0, 4.0)) / VOXEL_M).astype(int)
    assert found == dict(zip(map(tuple, (places + low).tolist()), grid[tuple(places.T)].tolist(), strict=True))


def test_counts_are_told_apart_where_many_frames_vote_for_one_voxel() -> None:
    bricks, grid, at_rest = VoteBricks(64), np.zeros(PAPER.shape, np.uint8), SE3.identity()
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
    with refused_as("DST-072", match="meadow"):
        list(labels.tiles())


def test_votes_of_a_tile_are_put_together_before_its_file_grows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("services.labeler.imports.fused_labels.LEAST_RECORDS", 100)
    labels, grid = FusedLabels("meadow", tmp_path / "votes", VoteBricks(64)), np.zeros(PAPER.shape, np.uint8)
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


def drawn(seed: int, highest: int, share: float) -> Grid:
    random = np.random.default_rng(seed)
    grid = random.integers(0, highest + 1, PAPER.shape, np.uint8)
    grid[random.random(PAPER.shape) > share] = 0
    return grid


@given(st.integers(0, 2**31), st.sampled_from([0.0, 0.02, 1.0]), st.booleans())
@settings(max_examples=10, deadline=None)
def test_voxels_are_counted_by_class_wherever_the_grid_lies_in_memory(
    seed: int, share: float, is_shifted: bool
) -> None:
    grid = drawn(seed, 3, share)
    if is_shifted:
        grid = np.frombuffer(b"x" + grid.tobytes(), np.uint8, grid.size, 1).reshape(PAPER.shape)
    assert class_counts(grid) == np.bincount(grid.reshape(-1), minlength=4).tolist()


@given(st.integers(0, 2**31), st.sampled_from([0.0, 0.5, 1.0]))
@settings(max_examples=6, deadline=None)
def test_voxels_of_a_mask_are_counted(seed: int, share: float) -> None:
    mask = drawn(seed, 1, share)
    assert set_count(mask) == int(mask.sum())


SIZE_M = 0.5
Voxels = dict[tuple[int, int, int], int]
places = st.tuples(st.integers(-3, 3), st.integers(-3, 3), st.integers(-3, 3))
worlds = st.dictionaries(places, st.integers(1, 3), max_size=40)
SIDES = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1))


def arrays_of(voxels: Voxels) -> tuple[np.ndarray, np.ndarray]:
    ordered = sorted(voxels)
    keys = keys_from_indices(np.array(ordered, np.int64).reshape(-1, 3))
    return keys, np.array([voxels[place] for place in ordered], np.uint8)


def faces_of(voxels: Voxels) -> set[tuple[tuple[float, ...], tuple[float, ...], int]]:
    """(middle, normal, class) of every face without a neighbour."""
    found = set()
    for place, kind in voxels.items():
        for side in SIDES:
            if tuple(np.add(place, side)) not in voxels:
                middle = (np.array(place) + 0.5 + np.array(side) / 2) * SIZE_M
                found.add((tuple(middle.tolist()), tuple(map(float, side)), kind))
    return found


@given(worlds)
@settings(max_examples=80, deadline=None)
def test_a_face_is_there_where_no_voxel_covers_it_and_shows_its_outside(voxels: Voxels) -> None:
    mesh = exposed_faces(*arrays_of(voxels), SIZE_M)
    corners = mesh.vertices_m[mesh.triangles].reshape(-1, 2, 3, 3)
    kinds = mesh.classes[mesh.triangles].reshape(-1, 6)
    assert (kinds == kinds[:, :1]).all()
    normals = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]) / SIZE_M**2
    assert np.array_equal(normals[:, 0], normals[:, 1])
    middles = corners.reshape(-1, 6, 3)[:, [0, 1, 2, 5]].mean(axis=1)
    found = [(tuple(m), tuple(n), int(k)) for m, n, k in zip(middles.tolist(), normals[:, 0].tolist(), kinds[:, 0])]  # noqa: B905
    assert len(found) == len(set(found))
    assert set(found) == faces_of(voxels)


@given(worlds)
@settings(max_examples=40, deadline=None)
def test_vertices_of_one_class_are_shared(voxels: Voxels) -> None:
    mesh = exposed_faces(*arrays_of(voxels), SIZE_M)
    named = {(*vertex, kind) for vertex, kind in zip(mesh.vertices_m.tolist(), mesh.classes.tolist(), strict=True)}  # type: ignore[misc]
    assert len(named) == len(mesh.vertices_m) == len(np.unique(mesh.triangles))


@given(worlds)
@settings(max_examples=40, deadline=None)
def test_a_coarser_voxel_has_the_highest_class_of_those_in_it(voxels: Voxels) -> None:
    keys, classes = coarser(*arrays_of(voxels))
    expected: Voxels = {}
    for (i, j, k), kind in voxels.items():
        expected[i >> 1, j >> 1, k >> 1] = max(kind, expected.get((i >> 1, j >> 1, k >> 1), 0))
    assert dict(zip(map(tuple, indices_of(keys).tolist()), classes.tolist(), strict=True)) == expected


def test_few_faces_are_few_and_lie_around_the_voxels() -> None:
    keys = keys_from_indices(np.argwhere(np.ones((40, 40, 1), np.bool_)).astype(np.int64))
    mesh = few_faces(keys, np.full(len(keys), 2, np.uint8), SIZE_M, 500)
    assert 0 < len(mesh.triangles) <= 500
    assert mesh.vertices_m.min(axis=0).tolist() == [0.0, 0.0, 0.0]
    assert (mesh.vertices_m.max(axis=0)[:2] == 40 * SIZE_M).all()


def test_the_corners_of_a_face_lie_in_one_plane() -> None:
    for side, corners in zip(SIDES, CORNERS, strict=True):
        along = corners @ np.array(side)
        assert (along == along[0]).all()
