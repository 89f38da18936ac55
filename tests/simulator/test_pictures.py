"""Pictures of the six cameras: their rays, their edges, their noise, and that they disturb nothing else."""

from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rosbags.highlevel import AnyReader

from simulator.options import SimulateOptions, SimulationOptionError
from simulator.pipeline import simulate
from simulator.scenery.scene import RayScene
from simulator.scenery.world import START_NS, build_world, generator
from simulator.sensors import rig
from simulator.sensors.cameras import COARSE_RAYS, SimulatedPicture, build_ring, take_pictures
from simulator.sensors.lidar import build_lidar, sweep_points
from tests.simulator.stage import OPTIONS, WALL_AHEAD_M, WALL_TOP_M, renderer, stage

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


def test_a_coarse_picture_has_few_rays_and_the_size_that_was_asked() -> None:
    coarse = replace(OPTIONS, camera_detail="coarse", camera_width_px=320)
    assert build_ring(coarse).directions.shape[1::-1] == COARSE_RAYS
    assert front(coarse).shape == (200, 320, 3)


def test_coarse_and_full_pictures_show_the_same_place() -> None:
    full, coarse = (front(replace(OPTIONS, camera_detail=detail)).astype(float) for detail in ("full", "coarse"))
    small = [
        np.asarray(Image.fromarray(one.astype(np.uint8)).resize((40, 25), Image.Resampling.BOX))
        for one in (full, coarse)
    ]
    assert np.abs(small[0].astype(float) - small[1]).mean() < 8


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


@pytest.mark.parametrize(("name", "value"), [("camera_detail", "fine"), ("illumination", "noon")])
def test_words_that_are_not_known_are_refused(name: str, value: str) -> None:
    with pytest.raises(SimulationOptionError, match=f"{name} is '{value}'; it must be one of"):
        SimulateOptions(**{name: value})
