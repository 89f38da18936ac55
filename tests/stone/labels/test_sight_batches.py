"""What cameras see: the definition voxel by voxel, one frame at a time, exact rays, and closed forms."""

import functools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone.geometry.se3 import SE3
from stone.labels.columns import gathered, spread_out
from stone.labels.sight_batches import LANES, SightBatch, _by_frame, _by_voxel
from stone.labels.visibility import IN_IMAGE, OPEN, VOXEL_BITS, framed, sight_lines, ways
from stone.sensors.calibration import CameraIntrinsics
from stone_base.label_grid import PAPER, RELEASE, LabelGrid
from testing.rays import in_voxels, lit_share, open_share

FRAMED = framed(PAPER.shape)
INTRINSICS = CameraIntrinsics("pinhole", 640, 480, 400.0, 400.0, 320.0, 240.0)
# z forward is ego x, x right is ego −y, y down is ego −z
FORWARD = np.array([0.5, -0.5, 0.5, -0.5])
EGO_FROM_CAMERA = SE3.from_parts(FORWARD, np.array([0.41, 0.03, 1.13]))


def centres(grid=PAPER):
    index = np.stack(np.meshgrid(*[np.arange(n) for n in grid.shape], indexing="ij"), axis=-1)
    return (index + 0.5) * grid.voxel_m + np.array(grid.min_m)


def pixels(ego_from_camera, k=INTRINSICS, grid=PAPER):
    """(u, v, depth) of every voxel centre, by the camera matrix."""
    matrix = np.array([[k.fx_px, 0, k.cx_px], [0, k.fy_px, k.cy_px], [0, 0, 1.0]])
    inverse = np.linalg.inv(ego_from_camera.as_matrix())
    u, v, depth = np.moveaxis((centres(grid) @ inverse[:3, :3].T + inverse[:3, 3]) @ matrix.T, -1, 0)
    ahead = np.where(depth > 0.1, depth, np.inf)
    return u / ahead, v / ahead, depth


def in_image(ego_from_camera, k=INTRINSICS, grid=PAPER):
    """Which voxels' centres lie in the image."""
    u, v, depth = pixels(ego_from_camera, k, grid)
    return (u >= 0) & (u < k.width_px) & (v >= 0) & (v < k.height_px) & (depth > 0.1)


def seen_in(classes, *lines):
    return spread_out(SightBatch(lines or [LINES()]).visible(gathered(classes)[None])[0]).astype(bool)


def test_in_an_empty_grid_all_of_the_image_is_seen_and_nothing_else():
    visible = seen_in(np.zeros(PAPER.shape, np.uint8))
    assert (visible == in_image(EGO_FROM_CAMERA)).all()
    assert visible.sum() > 100_000


@pytest.mark.parametrize("grid", [RELEASE, LabelGrid("near", (-3.0, -9.4, -1.0), 0.2, (40, 88, 8))], ids=str)
def test_of_any_grid_a_voxel_is_seen_if_the_definition_says_so(grid):
    """Voxel by voxel, the definition by recursion; two frames at once, one of them with nothing in the way."""
    lines = sight_lines(INTRINSICS, EGO_FROM_CAMERA, grid)
    rng, (x, y, z) = np.random.default_rng(11), grid.shape
    classes = np.zeros(grid.shape, np.uint8)
    classes[:, :, : z // 4] = 1
    for low in rng.integers([x // 2 + 4, y // 4, z // 4], [x - 8, 3 * y // 4, z // 2], (25, 3)):
        classes[tuple(slice(a, a + b) for a, b in zip(low, rng.integers(2, 6, 3), strict=True))] = 3
    occupied = np.stack([gathered(classes), gathered(np.zeros_like(classes))])
    seen = SightBatch([lines], grid).visible(occupied)
    visible, open_ = (spread_out(words, height=z).astype(bool) for words in seen)
    assert (open_ == in_image(EGO_FROM_CAMERA, grid=grid)).all()
    voxels, is_in_image = placed(lines, grid)
    in_view = set(map(tuple, voxels[lines.place >> VOXEL_BITS & 31 > 0].tolist()))
    camera = tuple(((EGO_FROM_CAMERA.translation_m - grid.min_m) / grid.voxel_m).tolist())
    of_view = np.flatnonzero(is_in_image)
    for voxel in sorted(map(tuple, voxels[rng.choice(of_view, 150, replace=False)].tolist())):
        assert visible[voxel] == is_seen(voxel, camera, classes == 0, in_view, {}), voxel
    assert 0.05 < visible[open_].mean() < 0.95


def test_what_any_of_two_cameras_sees_is_seen():
    backward = SE3.from_parts(np.array([0.5, -0.5, -0.5, 0.5]), EGO_FROM_CAMERA.translation_m)
    visible = seen_in(np.zeros(PAPER.shape, np.uint8), LINES(), sight_lines(INTRINSICS, backward))
    assert (visible == in_image(EGO_FROM_CAMERA) | in_image(backward)).all()
    assert visible[:64].any()
    assert visible[-64:].any()


def test_without_cameras_nothing_is_seen():
    occupied = np.zeros((3, *PAPER.shape[:2]), np.uint32)
    assert not SightBatch([]).visible(occupied).any()


@pytest.mark.parametrize("place", [133, 200])
def test_nothing_is_seen_behind_a_wall(place):
    classes = np.zeros(PAPER.shape, np.uint8)
    classes[place] = 3
    visible = seen_in(classes)
    free_view = in_image(EGO_FROM_CAMERA)
    assert (visible[: place + 1] == free_view[: place + 1]).all()
    assert not visible[place + 1 :].any()


def test_a_camera_outside_the_grid_sees_into_it():
    outside = SE3.from_parts(FORWARD, np.array([-40.0, 0.0, 1.0]))
    visible = seen_in(np.zeros(PAPER.shape, np.uint8), sight_lines(INTRINSICS, outside))
    assert (visible == in_image(outside)).all()
    assert visible.any()


LINES = functools.cache(lambda: sight_lines(INTRINSICS, EGO_FROM_CAMERA))


def scene(seed, boxes=10):
    """Ground and boxes on it."""
    rng = np.random.default_rng(seed)
    classes = np.zeros(PAPER.shape, np.uint8)
    classes[:, :, 8:10] = 1
    for low in rng.integers([132, 60, 8], [240, 190, 14], (boxes, 3)):
        classes[tuple(slice(a, b) for a, b in zip(low, low + rng.integers(3, 16, 3), strict=True))] = 3
    return classes


def placed(lines, grid=PAPER):
    """Voxels (S, 3) of the grid in the order of the lines, and which are in the image."""
    places = np.stack(np.unravel_index(lines.place & ((1 << VOXEL_BITS) - 1), framed(grid.shape)), axis=1)
    return places - 1, lines.place & IN_IMAGE > 0


def way_of(voxel, camera, is_free, in_view, known):
    """How open the way to a voxel is: the definition, by recursion; beyond the view only what is there blocks."""
    if voxel in known:
        return known[voxel]
    to = [c - (v + 0.5) for c, v in zip(camera, voxel, strict=True)]
    longest = max(map(abs, to))
    reached = OPEN
    if longest > 1 and voxel in in_view:
        point = [v + t / longest for v, t in zip(voxel, to, strict=True)]
        main = [abs(t) for t in to].index(longest)
        point[main] = voxel[main] + round(math.copysign(1, to[main]))
        others = [(main + 1) % 3, (main + 2) % 3]
        corners, left, total = [(0, 0), (1, 0), (0, 1), (1, 1)], OPEN, 0
        for number, corner in enumerate(corners):
            near, share = list(point), 1.0
            for axis, up in zip(others, corner, strict=True):
                near[axis] = math.floor(point[axis]) + up
                share *= 1 - abs(point[axis] - near[axis])
            weight = left if number == 3 else min(left, round(share * OPEN))
            left -= weight
            inside = all(0 <= n < size for n, size in zip(near, is_free.shape, strict=True))
            if weight and inside and is_free[tuple(near)]:
                total += weight * way_of(tuple(near), camera, is_free, in_view, known)
            elif weight and not inside:
                total += weight * OPEN
        reached = total // OPEN
    known[voxel] = reached
    return reached


def is_seen(voxel, camera, is_free, in_view, known):
    """A voxel by its way; a labelled one also by the way to what lies before a side that faces the camera."""
    if 2 * way_of(voxel, camera, is_free, in_view, known) >= OPEN:
        return True
    if is_free[voxel]:
        return False
    for axis in range(3):
        gap = camera[axis] - (voxel[axis] + 0.5)
        before = tuple(v + (round(math.copysign(1, gap)) if a == axis else 0) for a, v in enumerate(voxel))
        is_lit = abs(gap) > 0.5 and before in in_view and is_free[before]
        if is_lit and 2 * way_of(before, camera, is_free, in_view, known) >= OPEN:
            return True
    return False


@pytest.mark.whole
def test_each_voxel_is_seen_as_the_definition_says():
    """Catches alone bit lanes that agree with each other and not with the definition, followed ray by ray."""
    classes = scene(4)
    voxels, is_inside = placed(LINES())
    visible = seen_in(classes)
    camera, known = in_voxels(EGO_FROM_CAMERA.translation_m).tolist(), {}
    in_view = set(map(tuple, voxels[(LINES().place >> VOXEL_BITS) & 31 > 0].tolist()))
    rng, kinds = np.random.default_rng(4), classes[tuple(voxels.T)] > 0
    chosen = np.concatenate([rng.choice(np.flatnonzero(is_inside & of), 80) for of in (kinds, ~kinds)])
    for voxel in sorted(map(tuple, voxels[chosen].tolist())):
        assert visible[voxel] == is_seen(voxel, camera, classes == 0, in_view, known), voxel
    for half in (chosen[:80], chosen[80:]):
        assert 3 < visible[tuple(voxels[half].T)].sum() < 77


@pytest.mark.parametrize("size", [1, 5, LANES])
def test_a_batch_of_any_size_gives_what_its_frames_give_alone(size):
    occupied = np.stack([gathered(scene(seed)) for seed in range(size)])
    batch = SightBatch([LINES()])
    together = batch.visible(occupied)
    chosen = {0, size // 2, size - 1}
    for frame in chosen:
        assert (batch.visible(occupied[frame : frame + 1])[0] == together[frame]).all()
    assert len({together[frame].tobytes() for frame in chosen}) == len(chosen)
    assert (batch.visible(occupied) == together).all()


def test_lanes_of_voxels_and_columns_of_frames_hold_the_same_bits():
    columns = np.random.default_rng(1).integers(0, 2**32, (LANES, PAPER.shape[0] * PAPER.shape[1]), np.uint32)
    free, back = np.zeros(np.prod(FRAMED), np.uint32), np.zeros_like(columns)
    _by_voxel(columns, PAPER.shape[:2], free)
    inside = free.reshape(FRAMED)[1:-1, 1:-1, 1:-1]
    for lane in (0, 13, LANES - 1):
        is_set = spread_out(columns[lane].reshape(PAPER.shape[:2])) == 1
        assert ((inside >> lane & 1 == 0) == is_set).all()
    inside[:] = ~inside
    assert free.reshape(FRAMED)[0].max() == 0
    _by_frame(free, PAPER.shape[:2], back)
    assert (back == columns).all()


@pytest.mark.whole
@settings(max_examples=4, deadline=None)
@given(st.integers(0, 2**32))
def test_every_line_comes_from_voxels_that_were_looked_at_before_or_from_outside_the_grid(seed):
    rng = np.random.default_rng(seed)
    turn = rng.normal(size=4)
    lines = sight_lines(INTRINSICS, SE3.from_parts(turn / np.linalg.norm(turn), rng.uniform(-30, 30, 3) * [1, 1, 0.1]))
    voxel, code = (lines.place & ((1 << VOXEL_BITS) - 1)).astype(np.int64), (lines.place >> VOXEL_BITS) & 31
    first, one, other = ways(PAPER.shape)[code, :3].T
    order = np.full(np.prod(FRAMED), len(voxel))
    order[voxel] = np.arange(len(voxel))
    grid = np.stack(np.unravel_index(np.arange(np.prod(FRAMED)), FRAMED), axis=1) - 1
    order[((grid < 0) | (grid >= PAPER.shape)).any(axis=1)] = -1
    for corner, step in enumerate((first, first + one, first + other, first + one + other)):
        used = (code > 0) & (lines.weight[:, corner] > 0)
        assert (order[(voxel + step)[used]] < np.flatnonzero(used)).all()
    assert (lines.weight.sum(axis=1, dtype=int)[code > 0] == OPEN).all()
    assert len(np.unique(voxel)) == len(voxel)


def test_a_free_voxel_is_seen_where_half_of_many_rays_to_it_come_through():
    classes = scene(seed := 1)
    visible = seen_in(classes)
    voxels, is_inside = placed(LINES())
    is_free = is_inside & (classes[tuple(voxels.T)] == 0)
    chosen = voxels[np.random.default_rng(seed).choice(np.flatnonzero(is_free), 1500, replace=False)]
    share = open_share(classes > 0, in_voxels(EGO_FROM_CAMERA.translation_m), chosen, 16, seed)
    seen = visible[tuple(chosen.T)]
    assert 0.2 < (share >= 0.5).mean() < 0.95
    assert (seen == (share >= 0.5)).mean() > 0.96  # they differ along silhouettes
    assert seen[share == 0].mean() < 0.05
    assert seen[share == 1].mean() > 0.95


@pytest.mark.whole
def test_what_is_labelled_is_seen_where_any_of_many_rays_ends_on_its_sides_as_in_occ3d():
    """Along a ray from the camera the first labelled voxel is observed, and nothing behind it."""
    classes = scene(seed := 2)
    visible = seen_in(classes)
    voxels, is_inside = placed(LINES())
    labelled = voxels[is_inside & (classes[tuple(voxels.T)] > 0)]
    chosen = labelled[np.random.default_rng(seed).choice(len(labelled), 3000, replace=False)]
    is_lit = lit_share(classes > 0, in_voxels(EGO_FROM_CAMERA.translation_m), chosen, 24, seed) > 0
    seen = visible[tuple(chosen.T)]
    assert is_lit.sum() > 100
    assert (seen == is_lit).mean() > 0.97
    assert seen[is_lit].mean() > 0.85  # by the way to their middles alone it would be less than half
    assert is_lit[seen].mean() > 0.9
