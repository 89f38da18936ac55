"""Labels can be recomputed from the published files alone: vertices and features of `mesh.ply`, and the poses."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.stats import chi2

from benchmarks.real.labelled_map import read_map
from services.labeler.local_run import LabelOptions, label
from services.labeler.parameters import TilingParameters, parameters_for
from stone.geometry.lattice import indices_of
from stone.labels.grid import GRID_MIN_M
from stone.sensors.calibration import Box
from tests.services.labeler.straight_line import Constants, driven_voxels
from tests.services.labeler.worlds import RayCast, World, sequence_of

BOXES = (Box((1.5, 2.0, 0.0), (2.7, 3.2, 1.4)), Box((-3.0, -2.6, 0.0), (-1.2, -1.2, 0.12)))
# Sparse, so that trimming leaves vertices without a triangle, which count all the same.
TURNED = (np.cos(0.2), 0, 0, np.sin(0.2), 24.07, 23.9, 1.3)
WORLD = World(grade=(0.0613, 0.0227), boxes=BOXES, spacing_m=0.35, map_from_world=TURNED)
SMALL_TILES = TilingParameters(cube_cells=56)  # cores of 8 m: the world lies in nine
GREY = 128
FLOOR_M_RAD_LOG_M2, FLOOR_VOXELS = (0.3, 0.07, 0.7), 200


def means_by_voxel(folder: Path) -> dict[tuple[int, ...], np.ndarray]:
    """Eq. 4-5: the mean features of the vertices in each voxel, without grey ones: a neighbouring tile has them."""
    rows = trimesh.load(folder / "mesh.ply", process=False).metadata["_ply_raw"]["vertex"]["data"]
    found: dict[tuple[int, ...], list[tuple[float, ...]]] = {}
    for row in rows[(rows["red"] != GREY) | (rows["green"] != GREY)]:
        voxel = tuple(int(np.floor(float(row[axis]) / 0.2)) for axis in "xyz")
        found.setdefault(voxel, []).append((row["elevation"], row["slope"], row["roughness"]))
    return {voxel: np.mean(np.float64(vertices), axis=0) for voxel, vertices in found.items()}


def above_ground(means: dict[tuple[int, ...], np.ndarray]) -> dict[tuple[int, ...], np.ndarray]:
    """The same with the height above the lowest surface within half a metre, that smoothed, in place of elevation."""
    lowest: dict[tuple[int, int], float] = {}
    for (i, j, _), mean in means.items():
        lowest[i, j] = min(lowest.get((i, j), np.inf), mean[0])
    square = [(i, j) for i in range(-2, 3) for j in range(-2, 3)]
    around = {(i + di, j + dj) for i, j in lowest for di, dj in square}
    floor = {(i, j): min(lowest.get((i + di, j + dj), np.inf) for di, dj in square) for i, j in around}
    smooth = {
        (i, j): np.mean([floor[i + di, j + dj] for di, dj in square if (i + di, j + dj) in floor]) for i, j in lowest
    }
    return {voxel: np.array([mean[0] - smooth[voxel[:2]], *mean[1:]]) for voxel, mean in means.items()}


@pytest.fixture(scope="module", params=["paper", "local"])
def made(request, tmp_path_factory) -> tuple[str, Path]:
    folder = tmp_path_factory.mktemp(request.param) / "labels"
    parameters = replace(parameters_for(request.param), tiling=SMALL_TILES)
    label(sequence_of(WORLD), RayCast(WORLD), folder, LabelOptions(parameters, 1))
    return request.param, folder


def test_the_published_features_give_the_classes_of_the_map(made) -> None:
    profile, folder = made
    features = means_by_voxel(folder)
    if profile == "local":
        features = above_ground(features)
    driven = driven_voxels(list(features), sequence_of(WORLD).frames.map_from_ego.as_matrix(), Constants())
    reference = np.array([features[voxel] for voxel in sorted(driven)])
    mean, covariance = reference.mean(axis=0), np.cov(reference.T)
    if profile == "local":
        covariance += np.diag(np.square(FLOOR_M_RAD_LOG_M2)) * FLOOR_VOXELS / (FLOOR_VOXELS + len(reference))
    squared = {voxel: (row - mean) @ np.linalg.solve(covariance, row - mean) for voxel, row in features.items()}
    limit = chi2.ppf(0.95, df=3)
    mine = {voxel: 1 if voxel in driven else 2 if squared[voxel] <= limit else 3 for voxel in features}
    theirs = read_map(folder)
    labelled = dict(zip(map(tuple, indices_of(theirs.keys).tolist()), theirs.classes.tolist(), strict=True))
    differing = {voxel for voxel in mine.keys() | labelled.keys() if mine.get(voxel) != labelled.get(voxel)}
    assert len(labelled) > 3000
    assert min(np.bincount(theirs.classes)[1:]) > 50
    assert len(differing) <= 0.001 * len(labelled)


def test_the_report_has_the_share_of_occupied_voxels_whose_centre_is_in_no_labelled_voxel_of_the_map(made) -> None:
    _, folder = made
    frames, labelled = sequence_of(WORLD).frames, {tuple(row) for row in indices_of(read_map(folder).keys).tolist()}
    occupied, filled = 0, 0
    for token, pose in zip(frames.tokens, frames.map_from_ego.as_matrix(), strict=True):
        at = np.argwhere(np.load(folder / "gts" / "small" / token / "labels.npz")["semantics"])
        centres = ((at + 0.5) * 0.2 + GRID_MIN_M) @ pose[:3, :3].T + pose[:3, 3]
        occupied += len(at)
        filled += sum(tuple(voxel) not in labelled for voxel in np.floor(centres / 0.2).astype(int).tolist())
    share = json.loads((folder / "report.json").read_text())["filled_share_of_occupied"]
    assert share == pytest.approx(filled / occupied, abs=2e-4)
    assert share > 0.02
