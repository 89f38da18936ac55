"""Ground is the right way up however flat it is looked at, and what hangs over it is not taken for ground."""

import numpy as np
import pytest

from stone.geometry.lattice import MASK
from stone.geometry.se3 import SE3
from stone.surface.band import band_of
from stone.surface.contour import zero_surface
from stone.surface.mesh import vertex_normals
from stone.surface.neighbours import is_near
from stone.surface.patches import patches_of
from stone.surface.pointmap import PointMap, PointMapBuilder
from stone.surface.screened_poisson import PoissonParameters, solve_field

WIDTH_M, NEIGHBOURS, NOISE_M, JITTER_M = 0.2, 20, 0.02, 0.005
ELEVATION_DEG = {16: (-15, 15), 32: (-30.67, 10.67), 64: (-24.9, 2), 128: (-25, 15)}
# Nobody sees more of the ground than a low sensor that hardly moves sees badly.
FRAMES, STEP_M, REACH_M = 3, 0.3, 25.0


def rays(channels, columns=1800):
    elevation = np.deg2rad(np.linspace(*ELEVATION_DEG[channels], channels))
    azimuth = np.linspace(0, 2 * np.pi, columns, endpoint=False)
    up, around = np.meshgrid(elevation, azimuth, indexing="ij")
    return np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], -1).reshape(-1, 3)


def seen(channels, height_m, planes):
    """Noisy points, from poses a little off, on planes n·x = d within the extents in x that are given for each."""
    rng, builder, directions = np.random.default_rng(1), PointMapBuilder(0.1), rays(channels)
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


@pytest.mark.parametrize("height_m", [0.6, 1.7])
@pytest.mark.parametrize("channels", [16, 32, 64, 128])
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
