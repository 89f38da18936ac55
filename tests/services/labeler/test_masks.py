"""What labels say beside the classes, on a world ray-cast in closed form: both masks against rays, and confidence."""

import json
from dataclasses import replace

import numpy as np
import pytest

from services.eval.ground_truth import read_truth
from services.labeler.local_run import LabelOptions, label
from services.labeler.parameters import REFERENCES, LabelParameters
from stone.labels.grid import frame_bounds
from stone.labels.sight_batches import SightBatch
from stone.labels.traversability import NON_TRAVERSABLE, POTENTIAL, TRAVERSABLE, threshold
from stone.labels.visibility import sight_lines
from stone.labels.voxels import VOXEL_M
from stone.scoring.truth_hash import truth_hash
from stone.sensors.calibration import Box
from stone_base.label_grid import PAPER
from testing.rays import cast, in_voxels, lit_share, open_share
from tests.golden_vectors import MASKS
from tests.services.labeler.worlds import CALIBRATION, CAMERA, EGO_FROM_LIDAR, RayCast, World, sequence_of
from tests.services.runtime.view_decoding import Read

# a tile's corner lies in the middle of it, and part of the second box is behind the first
WORLD = World(
    grade=(0.05, 0.02), boxes=(Box((2.4, -0.9, 0.0), (3.2, 0.3, 0.9)), Box((4.6, -1.8, 0.0), (5.6, 1.4, 1.6)))
)
SEQUENCE = sequence_of(WORLD)
EGO_FROM_CAMERA = CALIBRATION.ego_from_lidar @ CAMERA.lidar_from_sensor


def labelled(folder, **parameters):
    """The files of the labels of each frame."""
    label(SEQUENCE, RayCast(WORLD), folder, LabelOptions(replace(LabelParameters(), **parameters)))
    return [folder / "gts" / "small" / token / "labels.npz" for token in SEQUENCE.frames.tokens]


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return labelled(tmp_path_factory.mktemp("plain") / "out")


@pytest.fixture(scope="module")
def confident(tmp_path_factory):
    return labelled(tmp_path_factory.mktemp("confident") / "out", confidence=True)


def centres_ego():
    index = np.stack(np.meshgrid(*[np.arange(n) for n in PAPER.shape], indexing="ij"), axis=-1)
    return (index + 0.5) * VOXEL_M + np.array(PAPER.min_m)


@pytest.mark.whole
def test_mask_lidar_is_every_voxel_that_a_ray_of_the_run_reached_or_passed(plain):
    low, high = frame_bounds(SEQUENCE.frames.map_from_ego)
    passed = np.zeros(tuple(high - low), np.bool_)
    for index in range(WORLD.frames):  # sweeps of so few rays are all followed
        map_from_lidar = SEQUENCE.frames.map_from_ego[index] @ EGO_FROM_LIDAR
        points_map = map_from_lidar @ RayCast(WORLD).sweep(index).points_lidar.astype(np.float64)
        nothing = np.zeros_like(passed)
        passed |= cast(nothing, map_from_lidar.translation_m / VOXEL_M - low, points_map / VOXEL_M - low)[1]
    for index in (0, 7):
        grids = np.load(plain[index])
        at = np.floor(SEQUENCE.frames.map_from_ego[index] @ centres_ego() / VOXEL_M).astype(np.int64) - low
        expected = passed[tuple(np.moveaxis(at, -1, 0))] | (grids["semantics"] > 0)
        assert expected.sum() > 10_000
        assert (grids["mask_lidar"] != expected).sum() < 0.002 * expected.sum()  # points in float32, at voxel borders


@pytest.mark.whole
def test_late_is_what_no_ray_of_a_sweep_up_to_the_frame_came_near(plain):
    low, high = frame_bounds(SEQUENCE.frames.map_from_ego)
    corner = low % 4  # bricks of 4 voxels are aligned with the map
    bricks = np.full(tuple((high - low + corner) // 4 + 1), WORLD.frames)
    for index in reversed(range(WORLD.frames)):
        map_from_lidar = SEQUENCE.frames.map_from_ego[index] @ EGO_FROM_LIDAR
        points_map = map_from_lidar @ RayCast(WORLD).sweep(index).points_lidar.astype(np.float64)
        nothing = np.zeros(tuple(high - low), np.bool_)
        passed = cast(nothing, map_from_lidar.translation_m / VOXEL_M - low, points_map / VOXEL_M - low)[1]
        bricks[tuple(((np.argwhere(passed) + corner) // 4).T)] = index
    for index, least in ((0, 1000), (3, 200), (WORLD.frames - 1, 0)):
        grids = np.load(plain[index])
        at = np.floor(SEQUENCE.frames.map_from_ego[index] @ centres_ego() / VOXEL_M).astype(np.int64) - low
        first = bricks[tuple(np.moveaxis((at + corner) // 4, -1, 0))]
        expected = (first > index + 4) & (first < WORLD.frames) & (grids["mask_lidar"] > 0)
        assert expected.sum() >= least
        assert (grids["late"] != expected).sum() <= 0.01 * expected.sum()  # points in float32, at voxel borders


@pytest.mark.whole
@pytest.mark.parametrize("index", [0, 7])
def test_mask_camera_is_where_half_of_many_rays_come_through_or_any_ends_on_a_side(plain, index):
    grids = np.load(plain[index])
    classes, seen = grids["semantics"], grids["mask_camera"] > 0
    depth_m = (EGO_FROM_CAMERA.inverse() @ centres_ego())[..., 2]
    ahead = (grids["mask_lidar"] > 0) & in_image() & (depth_m < 9)
    camera = in_voxels(EGO_FROM_CAMERA.translation_m)
    free, held = np.argwhere(ahead & (classes == 0)), np.argwhere(ahead & (classes > 0))
    rng = np.random.default_rng(index)
    free = free[rng.choice(len(free), 1500, replace=False)]
    is_open = open_share(classes > 0, camera, free, 16, index) >= 0.5
    is_lit = lit_share(classes > 0, camera, held, 16, index) > 0
    assert 0.3 < is_open.mean() < 0.99
    assert (seen[tuple(free.T)] == is_open).mean() > 0.96
    assert 0.1 < is_lit.mean() < 0.9
    assert (seen[tuple(held.T)] == is_lit).mean() > 0.85
    assert seen[tuple(held.T)][is_lit].mean() > 0.8
    assert not seen[~in_image()].any()


def in_image():
    """Which voxels the camera has in its image when nothing is in the way."""
    assert CAMERA.intrinsics is not None
    nothing = np.zeros((1, *PAPER.shape[:2]), np.uint32)
    (words,) = SightBatch([sight_lines(CAMERA.intrinsics, EGO_FROM_CAMERA)]).visible(nothing)
    return np.unpackbits(words.view(np.uint8), bitorder="little").reshape(PAPER.shape).astype(bool)


def test_confidence_is_an_array_more_and_changes_nothing_else(plain, confident):
    for one, other in zip(plain, confident, strict=True):
        with np.load(one) as without, np.load(other) as having:
            assert having.files == [*without.files, "distance_squared"]
            assert all((without[name] == having[name]).all() for name in without.files)


def test_the_distance_of_every_voxel_explains_its_class(confident):
    limit = threshold(LabelParameters().reference.alpha)
    for path in confident[::5]:
        grids = np.load(path)
        classes, squared = grids["semantics"], grids["distance_squared"]
        assert (squared.dtype, squared.shape) == (np.float16, PAPER.shape)
        assert np.isfinite(squared).all()
        assert ((squared == -1) == (classes == 0)).all()
        assert (squared[classes > 0] >= 0).all()
        assert squared[classes == POTENTIAL].max() <= limit * 1.001  # float16 rounds
        assert squared[classes == NON_TRAVERSABLE].min() >= limit * 0.999
        assert len(np.unique(squared)) > 100


def test_profile_field_gives_every_label_the_probability_that_it_is_right(tmp_path):
    in_frames = set()
    for path in labelled(tmp_path / "out", confidence=True, profile="field", reference=REFERENCES["field"])[::5]:
        with np.load(path) as grids:
            classes, confidence = grids["semantics"], grids["confidence"]
        assert (confidence.dtype, confidence.shape) == (np.uint8, PAPER.shape)
        assert ((confidence == 0) == (classes == 0)).all()
        assert (confidence[classes == TRAVERSABLE] == 255).all()
        assert confidence[classes == POTENTIAL].mean() > 0.99 * 255  # a plain without noise
        on_boxes = confidence[:, :, 13:][classes[:, :, 13:] == NON_TRAVERSABLE]  # from 0.6 m above it
        assert len(on_boxes) > 50
        assert on_boxes.mean() > 0.95 * 255
        assert len(np.unique(confidence)) > 30
        in_frames |= set(confidence[classes > 0].tolist())
    in_map = set()
    for path in (tmp_path / "out" / "scene").glob("tile_*.bin"):
        read = Read(path.read_bytes(), b"STT1")
        (count,) = read.values("I", 1)
        read.values("i", 3 * count)
        classes, _, confidence = read.values("B", count), read.values("f", 4 * count), read.values("B", count)
        assert {sure for kind, sure in zip(classes, confidence, strict=True) if kind == TRAVERSABLE} <= {255}
        in_map |= set(confidence)
    assert in_frames <= in_map - {0} == in_map  # frames are cut out of the map that the viewer shows
    assert json.loads((tmp_path / "out" / "scene" / "scene.json").read_text())["has_confidence"] is True


def test_labels_with_confidence_are_the_same_ground_truth(plain, confident):
    for mask in MASKS:
        assert truth_hash(read_truth(plain[3], mask)) == truth_hash(read_truth(confident[3], mask))
