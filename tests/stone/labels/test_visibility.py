"""What a camera sees, against exact rays through the grid."""

import numpy as np
import pytest

from stone.geometry.se3 import SE3
from stone.labels.columns import gathered, spread_out
from stone.labels.grid import GRID_MIN_M, GRID_SHAPE
from stone.labels.sight_batches import SightBatch
from stone.labels.visibility import sight_lines
from stone.labels.voxels import VOXEL_M
from stone.sensors.calibration import CameraIntrinsics

INTRINSICS = CameraIntrinsics("pinhole", 640, 480, 400.0, 400.0, 320.0, 240.0)
# z forward is ego x, x right is ego −y, y down is ego −z
FORWARD = np.array([0.5, -0.5, 0.5, -0.5])
EGO_FROM_CAMERA = SE3.from_parts(FORWARD, np.array([0.41, 0.03, 1.13]))


def centres():
    index = np.stack(np.meshgrid(*[np.arange(n) for n in GRID_SHAPE], indexing="ij"), axis=-1)
    return (index + 0.5) * VOXEL_M + np.array(GRID_MIN_M)


def pixels(ego_from_camera, k=INTRINSICS):
    """(u, v, depth) of every voxel centre, by the camera matrix."""
    matrix = np.array([[k.fx_px, 0, k.cx_px], [0, k.fy_px, k.cy_px], [0, 0, 1.0]])
    inverse = np.linalg.inv(ego_from_camera.as_matrix())
    u, v, depth = np.moveaxis((centres() @ inverse[:3, :3].T + inverse[:3, 3]) @ matrix.T, -1, 0)
    ahead = np.where(depth > 0.1, depth, np.inf)
    return u / ahead, v / ahead, depth


def in_image(ego_from_camera, border_voxels=0.0, k=INTRINSICS):
    """Which voxels' centres lie in the image, so many voxels away from its border."""
    u, v, depth = pixels(ego_from_camera, k)
    border = border_voxels * VOXEL_M * k.fx_px / np.maximum(depth, 0.1)
    wide = (u >= border) & (u < k.width_px - border)
    return wide & (v >= border) & (v < k.height_px - border) & (depth > 0.1)


@pytest.fixture(scope="module")
def lines():
    return sight_lines(INTRINSICS, EGO_FROM_CAMERA)


def seen_in(classes, lines):
    return spread_out(SightBatch([lines]).visible(gathered(classes)[None])[0])


def test_in_an_empty_grid_all_of_the_image_is_seen_and_nothing_else(lines):
    visible = seen_in(np.zeros(GRID_SHAPE, np.uint8), lines)
    assert set(np.unique(visible)) == {0, 1}
    assert (visible.astype(bool) == in_image(EGO_FROM_CAMERA)).all()
    assert visible.sum() > 100_000


def test_what_any_of_two_cameras_sees_is_seen(lines):
    backward = SE3.from_parts(np.array([0.5, -0.5, -0.5, 0.5]), EGO_FROM_CAMERA.translation_m)
    both = SightBatch([lines, sight_lines(INTRINSICS, backward)])
    empty = np.zeros(GRID_SHAPE, np.uint8)
    visible = spread_out(both.visible(gathered(empty)[None])[0]).astype(bool)
    assert (visible == in_image(EGO_FROM_CAMERA) | in_image(backward)).all()
    assert visible[:64].any()
    assert visible[-64:].any()


def test_without_cameras_nothing_is_seen():
    occupied = np.zeros((3, *GRID_SHAPE[:2]), np.uint32)
    assert not SightBatch([]).visible(occupied).any()


@pytest.mark.parametrize("place", [133, 150, 200])
def test_nothing_is_seen_behind_a_wall(lines, place):
    classes = np.zeros(GRID_SHAPE, np.uint8)
    classes[place] = 3
    visible = seen_in(classes, lines).astype(bool)
    free_view = in_image(EGO_FROM_CAMERA)
    assert (visible[: place + 1] == free_view[: place + 1]).all()
    assert not visible[place + 1 :].any()


def rays_see(classes, ego_from_camera, voxels):
    """Whether the straight way from the camera to each voxel centre passes no labelled voxel but the voxel itself."""
    origin = (ego_from_camera.translation_m - np.array(GRID_MIN_M)) / VOXEL_M
    clear = []
    for voxel in voxels:
        way = voxel + 0.5 - origin
        steps = origin + np.linspace(0, 1, int(20 * np.linalg.norm(way)) + 2)[:, None] * way
        cells = np.floor(steps).astype(int)
        cells = cells[((cells >= 0) & (cells < GRID_SHAPE)).all(axis=1) & (cells != voxel).any(axis=1)]
        clear.append(not classes[tuple(cells.T)].any())
    return np.array(clear)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_in_scenes_of_boxes_nearly_all_agrees_with_exact_rays(lines, seed):
    rng = np.random.default_rng(seed)
    classes = np.zeros(GRID_SHAPE, np.uint8)
    classes[:, :, 8:10] = 1
    for low in rng.integers([140, 60, 8], [240, 190, 14], (25, 3)):
        high = low + rng.integers(4, 16, 3)
        classes[tuple(slice(a, b) for a, b in zip(low, high, strict=True))] = 3
    visible = seen_in(classes, lines).astype(bool)
    voxels = np.argwhere(in_image(EGO_FROM_CAMERA, border_voxels=1.0))
    voxels = voxels[rng.choice(len(voxels), 3000, replace=False)]
    exact = rays_see(classes, EGO_FROM_CAMERA, voxels)
    assert 0.1 < exact.mean() < 0.9
    # interpolated lines against exact rays: they differ along silhouettes
    assert (visible[tuple(voxels.T)] == exact).mean() > 0.97


def test_a_camera_outside_the_grid_sees_into_it():
    outside = SE3.from_parts(FORWARD, np.array([-40.0, 0.0, 1.0]))
    visible = seen_in(np.zeros(GRID_SHAPE, np.uint8), sight_lines(INTRINSICS, outside))
    assert (visible.astype(bool) == in_image(outside)).all()
    assert visible.any()
