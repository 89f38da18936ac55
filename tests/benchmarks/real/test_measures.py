"""What is told of labels without a truth, on label sets whose figures are known beforehand."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.real.description import (
    Described,
    Description,
    LabelledScan,
    Semantics,
    own_descriptions,
    read_description,
)
from benchmarks.real.labelled_map import LabelledMap, disagreement, read_map
from benchmarks.real.measures import WrittenLabels, facing_down, flat_non_traversable, t_coverage
from benchmarks.real.measures import wall_non_traversable as wall_n
from benchmarks.real.opening import along
from benchmarks.real.semantic_agreement import agreement, semantic_counts
from services.domain.viewer.formats import TileVoxels, tile_bytes
from services.labeler.map.ply import write_mesh
from stone.geometry.lattice import keys_from_indices
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, Footprint
from stone.sensors.sequence import Frames, Sequence
from stone_base.label_grid import PAPER
from stone_recordings.calibrations.file import read_calibration

T, P, N = 1, 2, 3
SAID = Description(stone_real=1, name="yard", about="", calibration="", recording="yard.mcap")
Voxels = dict[tuple[int, int, int], int]


def labels_of(folder: Path, said: Description = SAID) -> WrittenLabels:
    """A label set in `folder` of a robot of 1 × 1 m that drove 10 m along x."""
    track = along(np.array([[0.0, 0.0], [10.0, 0.0]]))
    frames = Frames(track.stamps_ns[:1], ("t",), track.map_from_ego[:1])
    rig = Calibration("rig", SE3.identity(), (), Footprint(1.0, 1.0))
    sequence = Sequence("yard", frames, (), rig, "stated", track=track)
    return WrittenLabels(Described(said, folder / "yard.real.yaml", folder), sequence, folder)


def write_voxels(folder: Path, voxels: Voxels) -> None:
    (folder / "scene").mkdir(exist_ok=True)
    indices, classes = np.array(list(voxels), np.int64), np.array(list(voxels.values()), np.uint8)
    tile = TileVoxels(indices, classes, np.zeros((len(classes), 3)), np.zeros(len(classes)), np.zeros_like(classes))
    (folder / "scene" / "tile_0_0.bin").write_bytes(tile_bytes(tile))


def floor(x: range, y: range, kind: int) -> Voxels:
    return {(i, j, 0): kind for i in x for j in y}


def write_squares(folder: Path, heights_m: list[float], turned: set[int]) -> None:
    """A mesh of level squares of 1 m, one after another along x; those `turned` face down."""
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)
    vertices, triangles = list[NDArray[np.float32]](), list[NDArray[np.int32]]()
    for number, height_m in enumerate(heights_m):
        square = np.column_stack([corners + np.array([number % 8 * 1.2, 0]), np.full(4, height_m)])
        pair = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
        vertices.append(square.astype(np.float32))
        triangles.append((pair[:, ::-1] if number in turned else pair) + 4 * number)
    rows, faces = np.concatenate(vertices), np.concatenate(triangles)
    piece = rows, np.zeros_like(rows), faces, np.zeros(len(rows), np.uint8)
    write_mesh(folder / "mesh.ply", (len(rows), len(faces)), [lambda: piece])


def test_ground_that_faces_down_is_counted_and_undersides_are_not(tmp_path: Path) -> None:
    level, underside = [0.0] * 8, [2.0] * 8
    write_squares(tmp_path, level + underside, turned={3, 5, *range(8, 16)})
    assert facing_down(labels_of(tmp_path))["ground_down"] == pytest.approx(2 / 8)
    assert facing_down(labels_of(tmp_path))["flat_down"] is None


def test_a_track_is_covered_as_far_as_t_lies_under_it(tmp_path: Path) -> None:
    write_voxels(tmp_path, floor(range(-3, 53), range(-3, 3), T))
    assert t_coverage(labels_of(tmp_path)) == 1.0
    write_voxels(tmp_path, floor(range(-3, 25), range(-3, 3), T) | floor(range(25, 53), range(-3, 3), P))
    assert t_coverage(labels_of(tmp_path)) == pytest.approx(0.5, abs=0.02)
    write_voxels(tmp_path, {(i, j, 4): T for i, j, _ in floor(range(-3, 53), range(-3, 3), T)})
    assert t_coverage(labels_of(tmp_path)) == 0.0


def test_n_on_flat_ground_leaves_out_what_was_driven_and_what_stands_on_it(tmp_path: Path) -> None:
    ground = floor(range(50), range(-3, 3), T) | floor(range(50), range(3, 6), P) | floor(range(10), range(3, 6), N)
    posts = {(i, j, 5): N for i, j, _ in ground}
    write_voxels(tmp_path, ground | posts)
    said = SAID.model_copy(update={"flat_beside_track_m": 1.5})
    assert flat_non_traversable(labels_of(tmp_path, said)) == pytest.approx(0.2)
    assert flat_non_traversable(labels_of(tmp_path)) is None


def test_a_wall_is_judged_between_two_heights(tmp_path: Path) -> None:
    wall = {(i, 10, k): N if k < 8 else P for i in range(50) for k in range(20)}
    write_voxels(tmp_path, wall)
    said = SAID.model_copy(update={"walls_m": (((0.0, 2.1), (10.0, 2.1)),)})
    assert wall_n(labels_of(tmp_path, said)) == pytest.approx(5 / 9)  # levels 3 to 11, of which 3 to 7


def test_a_map_is_read_as_it_was_written_and_differs_from_itself_nowhere(tmp_path: Path) -> None:
    write_voxels(tmp_path, {(5, 0, 0): T, (1, 2, 3): P, (-4, 0, 0): N, (7, 7, 7): N})
    one = read_map(tmp_path)
    assert (
        one.keys.tolist()
        == np.sort(keys_from_indices(np.array([[5, 0, 0], [1, 2, 3], [-4, 0, 0], [7, 7, 7]]))).tolist()
    )
    assert disagreement(one, one) == (0.0, 0.0)
    turned = replace(one, classes=np.where(one.classes == T, np.uint8(P), one.classes))
    assert disagreement(one, turned) == (0.25, 0.0)
    other = LabelledMap(one.keys[:2], np.where(one.classes[:2] == N, np.uint8(T), np.uint8(N)))
    assert disagreement(one, other) == (1.0, 1.0)
    assert disagreement(one, LabelledMap(one.keys[:0], one.classes[:0])) == (None, None)


SEMANTICS = Semantics(
    scans=(LabelledScan(points="s.bin", labels="s.label"),), ground={"grass": 3}, obstacle={"tree": 4}
)


def with_scan(folder: Path, kinds: list[int]) -> NDArray[np.uint8]:
    """A scan of points in the grid's voxels (128 + i, 128, 10), one each, of these classes; and an empty grid."""
    points = np.zeros((len(kinds), 4), np.float32)
    points[:, :3] = np.array([0.1, 0.1, 0.1]) + np.outer(np.arange(len(kinds)), [0.2, 0, 0])
    points.tofile(folder / "s.bin")
    (np.array(kinds, "<u4") | 0x10000).astype("<u4").tofile(folder / "s.label")
    return np.zeros(PAPER.shape, np.uint8)


def write_grid(folder: Path, grid: NDArray[np.uint8]) -> None:
    (folder / "gts" / "yard" / "t").mkdir(parents=True)
    np.savez(folder / "gts" / "yard" / "t" / "labels.npz", semantics=grid)


def test_points_of_known_classes_are_counted_by_the_voxel_they_lie_in(tmp_path: Path) -> None:
    grid = with_scan(tmp_path, [3, 3, 3, 3, 3, 4, 4, 9])
    grid[128:135, 128, 10] = [T, P, P, N, 0, N, P]
    write_grid(tmp_path, grid)
    run = SAID.model_copy(update={"semantics": SEMANTICS})
    figures = agreement(semantic_counts(labels_of(tmp_path, run), SEMANTICS), SEMANTICS)
    assert figures["ground_tp"] == pytest.approx(3 / 4)
    assert figures["obstacle_n"] == pytest.approx(1 / 2)
    assert figures["unlabelled"] == pytest.approx(1 / 7)
    scan = run.model_copy(update={"recording": None, "scan": "s.bin"})
    stated = agreement(semantic_counts(labels_of(tmp_path, scan), SEMANTICS), SEMANTICS)
    assert stated["ground_tp"] == stated["T ∪ P of grass"] == pytest.approx(2 / 3)


def test_the_projects_own_descriptions_can_be_read_and_so_can_their_calibrations(tmp_path: Path) -> None:
    assert len(own_descriptions()) >= 2
    for path in own_descriptions():
        described = read_description(path, tmp_path)
        _, findings = read_calibration(described.file(described.description.calibration))
        assert [finding.code for finding in findings if finding.severity == "warning"] == []
