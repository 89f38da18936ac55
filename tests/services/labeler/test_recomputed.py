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
from stone.sensors.calibration import Box
from stone_base.label_grid import PAPER
from tests.services.labeler.straight_line import Constants, driven_voxels
from tests.services.labeler.worlds import RayCast, World, sequence_of

BOXES = (Box((1.5, 2.0, 0.0), (2.7, 3.2, 1.4)), Box((-3.0, -2.6, 0.0), (-1.2, -1.2, 0.12)))
# Sparse, so that trimming leaves vertices without a triangle, which count all the same.
TURNED = (np.cos(0.2), 0, 0, np.sin(0.2), 24.07, 23.9, 1.3)
WORLD = World(grade=(0.0613, 0.0227), boxes=BOXES, spacing_m=0.35, map_from_world=TURNED)
SMALL_TILES = TilingParameters(cube_cells=56)  # cores of 8 m: the world lies in nine
GREY = 128
FLOOR_M_RAD_LOG_M2, FLOOR_VOXELS = (0.3, 0.07, 0.7), 200
NOISE, CLEAN_MADS = (0.06, 0.09, 0.7), 3.5
SLOPE_DEG, STEP_M, HEIGHT_M, BODY_M = 20.0, 0.12, 1.6, 0.3
Means = dict[tuple[int, ...], np.ndarray]


def vertices_by_voxel(folder: Path) -> Means:
    """The features of the vertices in each voxel, without grey ones: a neighbouring tile has them."""
    rows = trimesh.load(folder / "mesh.ply", process=False).metadata["_ply_raw"]["vertex"]["data"]
    found: dict[tuple[int, ...], list[tuple[float, ...]]] = {}
    for row in rows[(rows["red"] != GREY) | (rows["green"] != GREY)]:
        voxel = tuple(int(np.floor(float(row[axis]) / 0.2)) for axis in "xyz")
        found.setdefault(voxel, []).append((row["elevation"], row["slope"], row["roughness"]))
    return {voxel: np.array(vertices, np.float64) for voxel, vertices in found.items()}


def around(voxel: tuple[int, ...], vertices: Means, reach: tuple[int, int]) -> list[tuple[int, ...]]:
    plan, levels = (range(-one, one + 1) for one in reach)
    near = ((voxel[0] + i, voxel[1] + j, voxel[2] + k) for i in plan for j in plan for k in levels)
    return [one for one in near if one in vertices]


def pooled(vertices: Means) -> Means:
    """The mean over all vertices of a voxel and its neighbours."""
    return {
        voxel: np.concatenate([vertices[one] for one in around(voxel, vertices, (1, 1))]).mean(axis=0)
        for voxel in vertices
    }


def limit_ratio(voxel: tuple[int, ...], means: Means) -> float:
    """The largest share of the vehicle's limits: slope within half a metre, a step to the next columns, clearance."""
    rows = []
    for one in around(voxel, means, (2, 3)):
        across_m = 0.2 * (np.array(one[:2]) - voxel[:2])
        if np.hypot(*across_m) <= 0.5:
            rows.append((*across_m, 1.0, means[one][0] - means[voxel][0]))
    design, rises = np.array(rows)[:, :3], np.array(rows)[:, 3]
    slope_deg = 0.0
    if len(rows) >= 4 and np.linalg.matrix_rank(design) == 3:
        slope_deg = np.rad2deg(np.arctan(np.hypot(*np.linalg.lstsq(design, rises, rcond=None)[0][:2])))
    near = np.abs(design[:, :2]).max(axis=1) < 0.3
    away = np.hypot(*design[near, :2].T)
    step_m = max(np.abs(rises[near]) - np.tan(np.deg2rad(SLOPE_DEG)) * away)
    above = [means[one][0] - means[voxel][0] for one in means if one[:2] == voxel[:2] and one[2] > voxel[2]]
    free_m = min([rise for rise in above if rise > BODY_M], default=np.inf)
    return max(slope_deg / SLOPE_DEG, step_m / STEP_M, HEIGHT_M / free_m)


def squared_distance(row: np.ndarray, covariance: np.ndarray, is_one_sided: bool) -> float:
    """D², or the least one of all that is at least as bad in each feature."""
    parts = [[0, 1, 2]] if not is_one_sided else [[0], [1], [2], [0, 1], [0, 2], [1, 2], [0, 1, 2]]
    found = [0.0] if is_one_sided else []
    for part in parts:
        pull = np.linalg.solve(covariance[np.ix_(part, part)], row[part])
        if not is_one_sided or (pull >= 0).all():
            found.append(row[part] @ pull)
    return max(found)


def above_ground(means: Means) -> Means:
    """The same with the height above the lowest surface within half a metre, that smoothed, in place of elevation."""
    lowest: dict[tuple[int, int], float] = {}
    for (i, j, _), mean in means.items():
        lowest[i, j] = min(lowest.get((i, j), np.inf), mean[0])
    square = [(i, j) for i in range(-2, 3) for j in range(-2, 3)]
    windows = {(i + di, j + dj) for i, j in lowest for di, dj in square}
    floor = {(i, j): min(lowest.get((i + di, j + dj), np.inf) for di, dj in square) for i, j in windows}
    smooth = {
        (i, j): np.mean([floor[i + di, j + dj] for di, dj in square if (i + di, j + dj) in floor]) for i, j in lowest
    }
    return {voxel: np.array([mean[0] - smooth[voxel[:2]], *mean[1:]]) for voxel, mean in means.items()}


@pytest.fixture(scope="module", params=["paper", "local", "field"])
def made(request, tmp_path_factory) -> tuple[str, Path]:
    folder = tmp_path_factory.mktemp(request.param) / "labels"
    parameters = replace(parameters_for(request.param), tiling=SMALL_TILES)
    label(sequence_of(WORLD), RayCast(WORLD), folder, LabelOptions(parameters, 1))
    return request.param, folder


def test_the_published_features_give_the_classes_of_the_map(made) -> None:
    profile, folder = made
    vertices = vertices_by_voxel(folder)
    means = {voxel: rows.mean(axis=0) for voxel, rows in vertices.items()}
    features = means if profile == "paper" else above_ground(means)
    if profile == "field":
        features = {voxel: np.array([features[voxel][0], *row[1:]]) for voxel, row in pooled(vertices).items()}
    driven = driven_voxels(list(features), sequence_of(WORLD).frames.map_from_ego.as_matrix(), Constants())
    reference = np.array([features[voxel] for voxel in sorted(driven)])
    if profile != "paper":
        off = np.abs(reference - np.median(reference, axis=0))
        spread = np.median(off, axis=0) * 1.4826
        spread = np.where(spread > 0, spread, reference.std(axis=0))  # most of this ground is as smooth as can be
        reference = reference[(off <= CLEAN_MADS * spread).all(axis=1)]
    mean, covariance = reference.mean(axis=0), np.cov(reference.T)
    if profile == "local":
        covariance += np.diag(np.square(FLOOR_M_RAD_LOG_M2)) * FLOOR_VOXELS / (FLOOR_VOXELS + len(reference))
    if profile == "field":
        covariance += np.diag(np.square(NOISE))
    limit, is_field = chi2.ppf(0.95, df=3), profile == "field"
    is_like = {v: squared_distance(row - mean, covariance, is_field) <= limit for v, row in features.items()}
    if is_field:
        is_like = {voxel: alike and limit_ratio(voxel, means) <= 1 for voxel, alike in is_like.items()}
    mine = {voxel: 1 if voxel in driven else 2 if is_like[voxel] else 3 for voxel in features}
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
        centres = ((at + 0.5) * 0.2 + PAPER.min_m) @ pose[:3, :3].T + pose[:3, 3]
        occupied += len(at)
        filled += sum(tuple(voxel) not in labelled for voxel in np.floor(centres / 0.2).astype(int).tolist())
    share = json.loads((folder / "report.json").read_text())["filled_share_of_occupied"]
    assert share == pytest.approx(filled / occupied, abs=2e-4)
    assert share > 0.02
