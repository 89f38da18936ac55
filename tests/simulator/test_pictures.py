"""How simulated places look: rays, edges, shade and noise of pictures, materials and lights."""

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rosbags.highlevel import AnyReader

from simulator.appearance import materials
from simulator.appearance import renderer as rendering
from simulator.appearance.lights import LIGHTS
from simulator.appearance.materials import GRAVEL, ROCK, SOIL, TALL, Spots, build_ground_cover
from simulator.appearance.renderer import MATERIALS, Renderer, View
from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from simulator.scenery import shapes
from simulator.scenery.movers import Mover, Route, Schedule, Vehicle, Walker
from simulator.scenery.objects import OBSTACLE, Objects, Surface
from simulator.scenery.path import DriveTrajectory
from simulator.scenery.scene import RayScene
from simulator.scenery.terrain import Terrain
from simulator.scenery.world import START_NS, SimulatedWorld, build_world, drivability, generator
from simulator.sensors import rig
from simulator.sensors.cameras import COARSE_RAYS, SimulatedPicture, build_ring, take_pictures
from simulator.sensors.lidar import build_lidar, sweep_points
from simulator.truth import DRIVABLE, truth_of
from stone.geometry.se3 import SE3
from stone.splits.surroundings import DAYLIGHT, ILLUMINATIONS

SWEEP_NS = START_NS + 215_000_000
# Ranges in mm of the first sweep of seed 11 with 4 × 24 rays, firing by firing, as recorded before there were textures.
OLD = SimulateOptions(seconds=0.4, seed=11, channels=4, columns=24, cameras=False, world_width_m=40.0)
OLD_RANGES_MM = (
    0, 7457, 5332, 369, 0, 7781, 5433, 365, 20925, 7502, 4916, 361, 0, 6902, 4793, 2343, 10632, 7035, 4764, 2365,
    10893, 6969, 4962, 2387, 11534, 7706, 4846, 2317, 10218, 8448, 4663, 2235, 15674, 9711, 4464, 2224, 0, 10967,
    4545, 2144, 18195, 14471, 4598, 2095, 0, 18464, 4579, 2104, 0, 34179, 4355, 2116, 0, 55395, 3985, 2163, 0, 30049,
    4029, 2147, 0, 24293, 4073, 2053, 0, 0, 4637, 2153, 0, 0, 5133, 2164, 0, 0, 7084, 2330, 0, 0, 7472, 2465, 0, 0,
    4422, 2394, 0, 0, 5993, 2326, 0, 8761, 5584, 405, 0, 8499, 5517, 377,
)  # fmt: skip
OLD_POSE = (0.985955, -0.021698, 0.011138, -0.165223, 42.285148, 20.976182, 1.278908)


def front(options: SimulateOptions, illumination: str = "day") -> np.ndarray:
    """The front camera's picture of the flat place (rows, columns, 3)."""
    options = replace(options, illumination=illumination)
    ring = build_ring(options)
    ring = replace(ring, cameras=ring.cameras[:1])
    (picture,) = take_pictures(renderer(stage(), illumination), ring, START_NS, generator(1, "camera"))
    return decoded(picture)


def decoded(picture: SimulatedPicture) -> np.ndarray:
    return np.asarray(Image.open(BytesIO(picture.jpeg))).astype(int)


@pytest.mark.parametrize("width_px", [480, 640])
def test_a_full_picture_has_a_ray_through_the_centre_of_each_pixel(width_px: int) -> None:
    lens = rig.intrinsics(width_px)
    rays = build_ring(replace(OPTIONS, camera_width_px=width_px)).directions.astype(float)
    assert rays.shape == (lens.height_px, lens.width_px, 3)
    seen = rays / rays[..., 2:]
    u, v = seen[..., 0] * lens.fx_px + lens.cx_px, seen[..., 1] * lens.fy_px + lens.cy_px
    columns, rows = np.meshgrid(np.arange(lens.width_px), np.arange(lens.height_px))
    np.testing.assert_allclose([u, v], [columns, rows], atol=1e-3)


def test_half_detail_has_a_ray_for_every_four_pixels_and_the_noise_of_a_sensor() -> None:
    half = replace(OPTIONS, camera_detail="half", camera_width_px=320)
    assert build_ring(half).directions.shape == (100, 160, 3)
    noisy, clean, full = front(replace(half, noise_ratio=1.0)), front(half), front(replace(half, camera_detail="full"))
    assert clean.shape == full.shape == (200, 320, 3)
    assert (
        np.abs(clean.astype(int) - full).mean()
        < np.abs(front(replace(half, camera_detail="coarse")).astype(int) - full).mean()
    )
    assert np.abs(noisy.astype(int) - clean).mean() > 0.5


def test_a_coarse_picture_has_few_rays_and_the_size_that_was_asked() -> None:
    coarse = replace(OPTIONS, camera_detail="coarse", camera_width_px=320)
    assert build_ring(coarse).directions.shape[1::-1] == COARSE_RAYS
    assert front(coarse).shape == (200, 320, 3)


def test_the_walls_edge_is_where_the_pinhole_puts_it() -> None:
    """Within a pixel and a half: its top against the sky in the middle column."""
    pixels = front(OPTIONS)
    lens = rig.intrinsics(OPTIONS.camera_width_px)
    face_m = WALL_AHEAD_M - 0.15 - 0.12
    row = lens.cy_px - lens.fy_px * (WALL_TOP_M - 0.80) / face_m
    blueness = pixels[:, lens.width_px // 2, 2] - pixels[:, lens.width_px // 2, 0]
    steps = np.diff(blueness[: round(lens.cy_px)].astype(float))
    assert abs(np.argmin(steps) + 0.5 - row) <= 1.5


def test_a_lidars_points_lie_where_the_cameras_rays_end() -> None:
    """Each return that a camera sees, put through its pinhole, has the depth of that pixel's ray."""
    options = SimulateOptions(
        seconds=0.2, seed=5, channels=48, columns=360, noise_ratio=0.0, traffic="none", camera_detail="full"
    )
    world, camera, lens = build_world(options), rig.cameras()[0], rig.intrinsics(480)
    scene, ring = RayScene(world), build_ring(options)
    records = sweep_points(scene, build_lidar(options), SWEEP_NS, generator(5, "lidar"))
    xyz = np.stack([records[axis] for axis in "xyz"], axis=-1).astype(float)[records["x"] != 0]
    stamps = np.round(records["timestamp"][records["x"] != 0] * 1e9).astype(np.int64)
    map_from_lidar = world.trajectory.at(stamps) @ rig.EGO_FROM_LIDAR
    points = np.einsum("nij,nj->ni", map_from_lidar.rotation(), xyz) + map_from_lidar.translation_m
    map_from_camera = world.trajectory.at(np.array([SWEEP_NS + camera.phase_ns]))[0] @ rig.ego_from_camera(camera)
    inside = map_from_camera.inverse() @ points
    u, v = (lens.fx_px * inside[:, :2] / inside[:, 2:] + (lens.cx_px, lens.cy_px)).round().astype(int).T
    is_seen = (inside[:, 2] > 0.5) & (u >= 0) & (v >= 0) & (u < lens.width_px) & (v < lens.height_px)
    ways = ring.directions[v[is_seen], u[is_seen]] @ map_from_camera.rotation().T.astype(np.float32)
    origins = np.tile(map_from_camera.translation_m.astype(np.float32), (len(ways), 1))
    cast_m = scene.cast(origins, ways.astype(np.float32)).range_m
    expected_m = np.linalg.norm(inside[is_seen], axis=1)
    assert is_seen.sum() > 500
    assert np.mean(np.abs(cast_m - expected_m) < 0.03 * expected_m) > 0.85  # others are hidden from one of the two


def test_pictures_are_noisier_at_night_and_without_noise_only_where_it_is_asked() -> None:
    def grain(illumination: str) -> float:
        noisy, clean = (front(replace(OPTIONS, noise_ratio=ratio), illumination) for ratio in (1.0, 0.0))
        return float((noisy - clean).std())

    assert 0.3 < grain("day") < 0.6 * grain("night")


def test_equal_options_give_equal_pictures_and_each_exposure_has_noise_of_its_own() -> None:
    noisy = replace(OPTIONS, noise_ratio=1.0, camera_width_px=160)
    ring, seen = build_ring(noisy), renderer(stage())
    first, again, later = (
        take_pictures(seen, ring, stamp_ns, generator(1, "camera"))
        for stamp_ns in (START_NS, START_NS, START_NS + 10**8)
    )
    assert [picture.jpeg for picture in first] == [picture.jpeg for picture in again]
    assert first[0].jpeg != later[0].jpeg


@pytest.mark.whole
def test_pictures_of_any_kind_disturb_no_other_message(tmp_path: Path) -> None:
    base = SimulateOptions(seconds=0.3, seed=3, channels=8, columns=60, camera_width_px=64, world_width_m=40.0)
    kinds = {
        "off": replace(base, cameras=False),
        "coarse": base,
        "night": replace(base, camera_detail="full", illumination="night"),
    }
    said = {}
    for name, options in kinds.items():
        simulate(tmp_path / f"{name}.mcap", options)
        said[name] = _messages(tmp_path / f"{name}.mcap")
    assert said["off"] == said["coarse"] == said["night"]


def _messages(path: Path) -> list[tuple[str, int, bytes]]:
    with AnyReader([path]) as reader:
        return sorted(
            (link.topic, log_time_ns, bytes(raw))
            for link, log_time_ns, raw in reader.messages()
            if not link.topic.startswith("/camera") and link.topic != "/tf_static"
        )


def test_an_older_recordings_seed_still_gives_its_geometry() -> None:
    """By value, since another processor may round otherwise: at most one ray in fifty may fall beside an edge."""
    world = build_world(OLD)
    records = sweep_points(RayScene(world), build_lidar(OLD), SWEEP_NS, generator(OLD.seed, "lidar"))
    range_mm = 1000 * np.sqrt(sum(records[axis].astype(float) ** 2 for axis in "xyz"))
    assert np.mean(np.abs(range_mm - OLD_RANGES_MM) < 2) >= 0.98
    np.testing.assert_allclose(world.trajectory.map_from_ego.wxyz_xyz[40], OLD_POSE, atol=2e-6)
    assert len(world.objects.triangles) == 88540


def test_an_older_seed_gives_its_things_and_a_drive_over_drivable_ground() -> None:
    world = build_world(replace(OLD, world_width_m=80.0, seconds=6.0))
    truth, near = truth_of(world, [START_NS]), world.terrain.path_distance_m < 25.0
    places = world.trajectory.map_from_ego.translation_m
    assert np.bincount(world.objects.surface).tolist() == [0, 0, 20628, 119899, 1940, 92433, 24, 1075]
    assert truth.is_drivable[near].mean() == pytest.approx(0.4357, abs=2e-3)
    assert np.ptp(places[:, 2]) == pytest.approx(2.598, abs=1e-3)
    assert np.all(truth.judge(places) == DRIVABLE)
    obstacles = world.objects.obstacles
    centres = np.stack([obstacles["x"], obstacles["y"]], axis=-1)
    apart_m = np.linalg.norm(centres - places[::20, None, :2], axis=-1) - obstacles["radius"]
    assert apart_m.min() > 0.45


ABOVE_M = np.array([0.0, 0.0, 6.0])


class FlatGround:
    def elevation_m(self, xy: np.ndarray) -> np.ndarray:
        return np.zeros(xy.shape[:-1])


def ground_points(x_m: tuple[float, float], y_m: tuple[float, float], count: int = 400) -> np.ndarray:
    """Scattered over a rectangle about the robot."""
    xy = np.random.default_rng(4).uniform((x_m[0], y_m[0]), (x_m[1], y_m[1]), (count, 2))
    return CENTRE_M + np.concatenate([xy, np.zeros((count, 1))], axis=1)


def walker_beside(trajectory: DriveTrajectory) -> tuple[Mover, ...]:
    return (Walker(Route(trajectory, FlatGround(), Schedule(0.0), aside_m=3.0)),)


def vehicle_beside(trajectory: DriveTrajectory) -> tuple[Mover, ...]:
    return (Vehicle(Route(trajectory, FlatGround(), Schedule(0.0), aside_m=3.0)),)


def seen_from_above(points: np.ndarray, illumination: str = "day", **of_stage) -> np.ndarray:
    return renderer(stage(**of_stage), illumination).pixels(looking_at(points, points + ABOVE_M)).astype(int)


def test_a_wall_shades_the_ground_as_far_as_its_height_over_the_tangent_of_the_suns_elevation() -> None:
    """Moving the wall by the length of its shade takes the shade away; the ground keeps its texture."""
    sun = LIGHTS["day"].towards
    far_m = WALL_TOP_M * sun[0] / sun[2]  # along x, away from the sun
    assert far_m > 0.5
    behind = WALL_AHEAD_M - 0.15
    shaded, lit = (
        ground_points((behind - far_m + 0.1, behind - 0.1), (-1, 1)),
        ground_points((2, behind - far_m - 0.1), (-1, 1)),
    )
    away = WALL_AHEAD_M + 8
    assert np.all(seen_from_above(shaded).sum(axis=1) < 0.8 * seen_from_above(shaded, wall_ahead_m=away).sum(axis=1))
    np.testing.assert_array_equal(seen_from_above(lit), seen_from_above(lit, wall_ahead_m=away))


@pytest.mark.parametrize("movers", [walker_beside, vehicle_beside])
def test_what_moves_casts_shade(movers) -> None:
    sun = LIGHTS["day"].towards
    foot = np.array([0.0, 3.0, 0.0])
    middle = foot - 1.2 * sun / sun[2]  # below the shade of its axis at 1.2 m
    points = CENTRE_M + (middle + np.random.default_rng(5).uniform(-0.05, 0.05, (50, 3))) * (1, 1, 0)
    origins = points + np.array([-0.4, 3.0, 1.0])
    with_it, without = (
        renderer(stage(movers=who)).pixels(looking_at(points, origins)).astype(int) for who in (movers, lambda _: ())
    )
    assert with_it.sum() < 0.85 * without.sum()


def test_every_word_for_the_light_has_one_and_nights_are_darker_than_days() -> None:
    assert set(LIGHTS) == set(ILLUMINATIONS)
    points = ground_points((-6, 4), (-6, 6), 200)
    brightness = {word: seen_from_above(points, word).mean() for word in ILLUMINATIONS}
    days = [value for word, value in brightness.items() if DAYLIGHT[word] == "day"]
    nights = [value for word, value in brightness.items() if DAYLIGHT[word] == "night"]
    assert max(nights) < min(days)
    assert brightness["night"] < brightness["moonlit"] < brightness["floodlit"]


def test_pieces_change_no_pixel_and_bound_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    seen, points = renderer(stage()), ground_points((-10, 10), (-10, 10), 24_000)
    view = looking_at(points, points + ABOVE_M)
    whole = seen.pixels(view)
    monkeypatch.setattr(rendering, "PIECE_RAYS", 3000)
    np.testing.assert_array_equal(seen.pixels(view), whole)
    peaks = [_peak_bytes(lambda count=count: seen.pixels(view.of(slice(count)))) for count in (6000, 24_000)]
    assert peaks[1] < 1.3 * peaks[0]


def _peak_bytes(run) -> int:
    tracemalloc.start()
    run()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


GROUND = {
    "grass": lambda spots: materials.grass(spots, np.zeros(len(spots.up_m), np.float32)),
    "soil": materials.soil,
    "gravel": materials.gravel,
}
ALL = {**GROUND, **{surface.name.lower(): colour for surface, colour in MATERIALS.items()}}


@pytest.fixture(scope="module")
def world() -> SimulatedWorld:
    return build_world(SimulateOptions(seconds=6.0, seed=2, world_width_m=60.0))


def spots_on_a_square() -> Spots:
    draw = np.random.default_rng(3)
    points = draw.uniform(0, 12, (4000, 3)).astype(np.float32)
    normals = np.tile(np.float32([1, 0, 0]), (4000, 1))
    return Spots(points, normals, points[:, 2] / 8, np.full(4000, 0.004, np.float32))


def test_the_ground_is_covered_once_and_as_it_is_drivable(world: SimulatedWorld) -> None:
    layers = build_ground_cover(world.terrain, generator(2, "cover")).layers
    shares = layers[..., [SOIL, GRAVEL, ROCK, TALL]]
    assert shares.min() >= 0
    assert shares.sum(axis=-1).max() <= 1 + 1e-5
    # The track is bare, what is too steep is rock, earth or gravel, and most of the rest is grass.
    terrain = world.terrain
    layers = build_ground_cover(terrain, generator(2, "cover")).layers
    field, bare = drivability(terrain.height_m, terrain.resolution_m), layers[..., [SOIL, GRAVEL, ROCK]].sum(axis=-1)
    is_beside = terrain.path_distance_m > 3.0
    assert layers[terrain.path_distance_m < 0.5, SOIL].mean() > 0.5
    assert bare[is_beside & field.is_drivable & (field.slope_rad < 0.3)].mean() < 0.2
    assert bare[is_beside & (field.slope_rad > np.deg2rad(32))].mean() > 0.8
    assert layers[~terrain.lowland & (field.slope_rad > np.deg2rad(38)), ROCK].mean() > 0.8


CENTRE_M = np.array([20.0, 20.0, 0.0])
WALL_AHEAD_M, WALL_TOP_M = 6.0, 1.8
OPTIONS = SimulateOptions(seconds=0.2, noise_ratio=0.0, traffic="none", camera_detail="full")


def stage(wall_ahead_m: float = WALL_AHEAD_M, movers: Callable[[DriveTrajectory], tuple[Mover, ...]] = lambda _: ()):
    """40 m × 40 m of lowland, the robot at rest in its middle, a wall along y ahead of it."""
    lattice = np.zeros((201, 201))
    terrain = Terrain(lattice, np.ones(lattice.shape, bool), np.full(lattice.shape, 10.0))
    wall = shapes.wall(8.0, 0.3, WALL_TOP_M, np.pi / 2) + CENTRE_M + (wall_ahead_m, 0, 0)
    none = np.zeros(0, OBSTACLE)
    objects = Objects(wall.astype(np.float32), np.full(len(wall), Surface.WALL, np.uint8), none, none)
    at_rest = SE3.from_parts(np.tile([1.0, 0, 0, 0], (401, 1)), np.tile(CENTRE_M, (401, 1)))
    trajectory = DriveTrajectory(START_NS, at_rest)
    return SimulatedWorld(terrain, objects, trajectory, movers(trajectory))


def renderer(world: SimulatedWorld, illumination: str = "day") -> Renderer:
    return Renderer(RayScene(world), SimulateOptions(seconds=0.2, illumination=illumination))


def looking_at(points: np.ndarray, origins: np.ndarray) -> View:
    """A ray from each origin (N, 3) to each point (N, 3), 3 mrad apart."""
    ways = points - origins
    directions = (ways / np.linalg.norm(ways, axis=1, keepdims=True)).astype(np.float32)
    return View(origins.astype(np.float32), directions, 0.003, START_NS, np.zeros((0, 7)))


def test_normals_of_movers_point_outwards() -> None:
    trajectory = stage().trajectory
    (walker,), (vehicle,) = walker_beside(trajectory), vehicle_beside(trajectory)
    foot = CENTRE_M + np.array([0, 3, 0])
    np.testing.assert_allclose(walker.normals(foot[None] + (0.25, 0, 1.0), START_NS), [[1, 0, 0]], atol=1e-6)
    faces = np.array([[2.1, 0.3, 1.0], [-2.1, 0.3, 1.0], [0.5, 0.9, 1.0], [0.5, -0.9, 1.0], [0.5, 0.3, 1.6]])
    expected = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]]
    np.testing.assert_allclose(vehicle.normals(foot + faces, START_NS), expected, atol=1e-6)


@pytest.mark.parametrize("name", ALL)
def test_a_material_looks_the_same_whatever_else_is_seen(name: str) -> None:
    spots = spots_on_a_square()
    np.testing.assert_array_equal(ALL[name](spots.of(np.arange(5, 9))), ALL[name](spots)[5:9])
