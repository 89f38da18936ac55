"""Ground is the right way up, what hangs over it is not taken for ground, and what wet ground mirrors is taken out."""

import numpy as np
import pytest

from stone.geometry.lattice import MASK
from stone.geometry.se3 import SE3
from stone.surface.contour import band_of, zero_surface
from stone.surface.mesh import vertex_normals
from stone.surface.neighbours import is_near
from stone.surface.patches import patches_of
from stone.surface.pointmap import PointMap, PointMapBuilder
from stone.surface.screened_poisson import PoissonParameters, solve_field

WIDTH_M, NEIGHBOURS, NOISE_M, JITTER_M = 0.2, 20, 0.02, 0.005
ELEVATION_DEG = {16: (-15, 15), 32: (-30.67, 10.67), 64: (-24.9, 2), 128: (-25, 15)}
MIRRORED_NOISE_M = 0.01
# Nobody sees more of the ground than a low sensor that hardly moves sees badly.
FRAMES, STEP_M, REACH_M = 3, 0.3, 25.0


def rays(elevation_deg, channels, columns=1800):
    elevation = np.deg2rad(np.linspace(*elevation_deg, channels))
    azimuth = np.linspace(0, 2 * np.pi, columns, endpoint=False)
    up, around = np.meshgrid(elevation, azimuth, indexing="ij")
    return np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], -1).reshape(-1, 3)


def seen(channels, height_m, planes):
    """Noisy points, from poses a little off, on planes n·x = d within the extents in x that are given for each."""
    rng, builder, directions = np.random.default_rng(1), PointMapBuilder(0.1), rays(ELEVATION_DEG[channels], channels)
    for frame in range(FRAMES):
        origin = np.array([frame * STEP_M, 0.0, height_m])
        nearest = np.full(len(directions), np.inf)
        for normal, offset, (low, high) in planes:
            with np.errstate(divide="ignore", invalid="ignore"):
                along = (offset - origin @ normal) / (directions @ normal)
                x = origin[0] + along * directions[:, 0]
            is_met = (along > 1) & (along < REACH_M) & (low <= x) & (x < high)
            nearest = np.where(is_met, np.minimum(nearest, along), nearest)
        is_met = np.isfinite(nearest)
        far_m = nearest[is_met] + NOISE_M * rng.standard_normal(is_met.sum())
        points = (directions[is_met] * far_m[:, None]).astype(np.float32)
        place = origin + JITTER_M * rng.standard_normal(3)
        builder.insert(points, SE3.from_parts(np.array([1.0, 0, 0, 0]), place), np.zeros(3))
    return builder.finish()


def patches(points: PointMap):
    return patches_of(points.centroids_map(), points.views_map(), WIDTH_M, NEIGHBOURS)


def mesh_normals(points: PointMap):
    found, is_in_patch = patches(points)
    band = band_of(found.cells, WIDTH_M)
    whole = zero_surface(band, solve_field(found, band, PoissonParameters()).values)
    keep = is_near(whole.vertices_map, points.centroids_map()[is_in_patch], WIDTH_M)
    return vertex_normals(whole)[keep]


FLAT = (np.array([0.0, 0.0, 1.0]), 0.0, (-np.inf, np.inf))


@pytest.mark.whole
@pytest.mark.parametrize(("channels", "height_m"), [(16, 0.6), (16, 1.7), (32, 0.6), (64, 1.7), (128, 0.6)])
def test_flat_ground_is_the_right_way_up_at_every_angle_and_resolution(channels, height_m):
    points = seen(channels, height_m, [FLAT])
    assert len(points) > 1000
    assert (patches(points)[0].normals[:, 2] < 0).mean() <= 0.003
    assert (mesh_normals(points)[:, 2] < 0).mean() <= 0.003


@pytest.mark.parametrize("grade", [0.05, 0.12])
def test_ground_that_rises_beyond_the_sensors_height_is_the_right_way_up(grade):
    """From 5 m on the road climbs, and farther off it is looked at from below."""
    hill = (np.array([-grade, 0.0, 1.0]), -5.0 * grade, (5.0, np.inf))
    points = seen(64, 0.6, [(FLAT[0], 0.0, (-np.inf, 5.0)), hill])
    found, _ = patches(points)
    is_above = found.points_map[:, 2] > 0.6
    assert is_above.sum() > 500 * (grade > 0.1)
    assert (found.normals[:, 2] < 0).mean() <= 0.003


def test_the_underside_of_what_hangs_over_the_ground_stays_an_underside():
    ceiling = (np.array([0.0, 0.0, 1.0]), 2.6, (3.0, 14.0))
    found, _ = patches(seen(128, 1.7, [FLAT, ceiling]))
    is_ceiling = found.points_map[:, 2] > 2.0
    columns = found.cells - (found.cells & MASK)
    has_ground = np.isin(columns, columns[~is_ceiling])
    assert (is_ceiling & has_ground).sum() > 500
    assert (found.normals[is_ceiling & has_ground, 2] > 0).mean() <= 0.003
    assert (found.normals[~is_ceiling, 2] < 0).mean() <= 0.003


def test_a_wall_keeps_the_side_it_was_seen_from():
    wall = (np.array([1.0, 0.0, 0.0]), 6.0, (-np.inf, np.inf))
    found, _ = patches(seen(64, 1.7, [FLAT, wall]))
    is_wall = (found.points_map[:, 2] > 0.4) & (np.abs(found.points_map[:, 1]) < 5)
    assert is_wall.sum() > 200
    assert (found.normals[is_wall, 0] > 0).mean() <= 0.003


EVERYWHERE = (-30.0, 30.0)
GROUND = (0.0, EVERYWHERE, EVERYWHERE)


def ranges(origins, directions, plates):
    """How far (R,) it is to the first of the plates, each a height and its extents in x and y."""
    nearest = np.full(len(directions), np.inf)
    for height_m, *extents in plates:
        with np.errstate(divide="ignore", invalid="ignore"):
            along = (height_m - origins[:, 2]) / directions[:, 2]
        at = origins + np.where(np.isfinite(along), along, 0.0)[:, None] * directions
        is_met = (along > 1e-6) & np.isfinite(along)
        for axis, (low, high) in enumerate(extents):
            is_met &= (low <= at[:, axis]) & (at[:, axis] < high)
        nearest = np.where(is_met, np.minimum(nearest, along), nearest)
    return nearest


def patches_seen(plates, origins, mirrored_ratio=0.0):
    """What is seen of the plates; so much of what meets the first of them is thrown on by it to what stands above."""
    rng, builder, directions = np.random.default_rng(3), PointMapBuilder(0.1), rays((-40, 20), 64)
    for origin in np.array(origins, float):
        starts = np.broadcast_to(origin, directions.shape)
        far_m = ranges(starts, directions, plates)
        hits = starts + np.where(np.isfinite(far_m), far_m, 0.0)[:, None] * directions
        is_thrown_on = np.isfinite(far_m) & (abs(hits[:, 2]) < 1e-9) & (rng.random(len(hits)) < mirrored_ratio)
        onward = ranges(hits, directions * [1, 1, -1], plates[1:])
        far_m = np.where(is_thrown_on & np.isfinite(onward), far_m + onward, far_m)
        is_met = far_m < 25.0
        noisy_m = far_m[is_met] + MIRRORED_NOISE_M * rng.standard_normal(is_met.sum())
        builder.insert(directions[is_met] * noisy_m[:, None], SE3(np.array([1.0, 0, 0, 0, *origin])), np.zeros(3))
    points = builder.finish()
    found, is_in_patch = patches_of(points.centroids_map(), points.views_map(), WIDTH_M, NEIGHBOURS)
    return found, points.centroids_map()[~is_in_patch]


def along_x(height_m, count=8):
    return [(x, 0.0, height_m) for x in np.linspace(0, 6, count)]


def test_the_image_of_a_board_over_wet_ground_is_taken_out_and_nothing_else():
    board = (2.2, (4.0, 8.0), (-3.0, 3.0))
    dry, _ = patches_seen([GROUND, board], along_x(1.6))
    wet, left_out = patches_seen([GROUND, board], along_x(1.6), mirrored_ratio=0.3)
    assert (left_out[:, 2] < -1.9).sum() > 100
    assert not (wet.points_map[:, 2] < -1.0).any()
    assert (wet.points_map[:, 2] > 2.0).sum() > 100
    assert abs((np.abs(wet.points_map[:, 2]) < 0.2).sum() / (np.abs(dry.points_map[:, 2]) < 0.2).sum() - 1) < 0.01


LOW_GROUND = (-1.0, (4.0, 30.0), EVERYWHERE)


@pytest.mark.whole
@pytest.mark.parametrize(
    ("plates", "origins"),
    [
        ([GROUND, (0.7, (3.0, 4.5), (1.5, 3.0))], along_x(1.8)),
        ([GROUND, (2.5, (8.0, 12.0), EVERYWHERE)], [*along_x(1.8), *((x, 0.0, 4.3) for x in (8.5, 10.0, 11.5))]),
        ([(0.0, (-30.0, 4.0), EVERYWHERE), LOW_GROUND], along_x(1.8, 4)),
    ],
    ids=["a table beside the track", "a bridge, from below and from above", "a terrace"],
)
def test_what_lies_below_something_and_is_seen_past_its_edge_stays(plates, origins):
    found, left_out = patches_seen(plates, origins)
    assert len(found) > 1000
    assert not is_below_something(left_out, found).any()


def is_below_something(points, found):
    """Which points have a patch above them."""
    columns = {tuple(column): height for *column, height in np.round(found.points_map / WIDTH_M).astype(int).tolist()}
    return np.array([columns.get(tuple(c), -99) > z + 1 for *c, z in np.round(points / WIDTH_M).astype(int).tolist()])


@pytest.mark.whole
@pytest.mark.parametrize("steepness", [0.6, 1.2])
def test_hills_mirror_nothing(steepness):
    rng = np.random.default_rng(5)
    builder = PointMapBuilder(0.1)
    length_m = 5.0
    steps = np.linspace(0.8, 12, 320)

    def height(x, y):
        return steepness * length_m / (2 * np.pi) * np.sin(2 * np.pi * x / length_m) * np.cos(2 * np.pi * y / 11.0)

    for x in np.linspace(-4, 4, 7):
        origin = np.array([x, 0.3, height(x, 0.3) + 1.5])
        directions = rays((-40, 20), 32, 600)
        is_under = np.zeros((len(directions), len(steps)), bool)
        for at, step in enumerate(steps):
            place = origin + step * directions
            is_under[:, at] = place[:, 2] < height(place[:, 0], place[:, 1])
        is_met = is_under.any(axis=1)
        far_m = steps[is_under.argmax(axis=1)][is_met] + MIRRORED_NOISE_M * rng.standard_normal(is_met.sum())
        builder.insert(directions[is_met] * far_m[:, None], SE3(np.array([1.0, 0, 0, 0, *origin])), np.zeros(3))
    points = builder.finish()
    found, is_in_patch = patches_of(points.centroids_map(), points.views_map(), WIDTH_M, NEIGHBOURS)
    assert len(found) > 2000
    assert (~is_in_patch).mean() < 0.002
