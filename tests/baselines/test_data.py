"""What a model is given of frames: nothing later, augmented alike everywhere; and how what it answers is scored."""

import math
import warnings
from dataclasses import dataclass, replace
from io import BytesIO
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from baselines.augment import (
    IMAGENET_DEVIATION,
    IMAGENET_MEAN,
    NO_AUGMENTATION,
    AugmentConfig,
    GridMirrors,
    changed_picture,
    draw_picture_change,
    generator_of,
)
from baselines.batch import Batch
from baselines.data import EpochSampler, FrameDataset, FrameRequest, depth_picture
from baselines.frame_record import FrameRecord, PictureRecord
from baselines.inputs import InputConfig
from baselines.lattice import VoxelLattice, grid_part
from baselines.metrics import confusion_of
from baselines.models.occupancy_model import OccupancyModel, likeliest
from baselines.train import joined, scores_on
from stone.geometry.se3 import SE3
from stone.scoring.metric import RATIOS
from stone_base.label_grid import PAPER

INPUTS = InputConfig("C+L+R", (24, 32), ("CAM_FRONT",), lidar_sweeps=4, radar_scans=3, with_depth=True)
SMALL = VoxelLattice((-3.2, -3.2, -1.2), shape=(32, 32, 16))
ALL = AugmentConfig(mirror_x_ratio=1, mirror_y_ratio=1)
MATRIX = np.array([[20.0, 0, 15.5], [0, 20, 11.5], [0, 0, 1]])
AHEAD = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 1], [0, 0, 0, 1]])
STEP_US = 100_000
# In voxels of the small lattice, at their centres: points of the world, which stands still.
WORLD_MAP = SMALL.centres_m()[::5, ::7, ::6].reshape(-1, 3).numpy().astype(np.float64)


@dataclass(frozen=True)
class Frames:
    """Frames in memory."""

    records: tuple[FrameRecord, ...]

    def __len__(self) -> int:
        return len(self.records)

    def key(self, index: int) -> tuple[str, int]:
        return self.records[index].sequence, self.records[index].stamp_us

    def read(self, index: int) -> FrameRecord:
        return self.records[index]


def pose_at(index: int) -> SE3:
    half = 0.15 * index
    wxyz = np.array([math.cos(half), 0.02 * index, 0, math.sin(half)])
    return SE3.from_parts(wxyz, np.array([0.35 * index, -0.2 * index, 0.05 * index]))


def record_at(index: int, sequence: str = "a") -> FrameRecord:
    """Returns and detections at the world's points; these all move with 1 m/s along the map's x."""
    points_ego = pose_at(index).inverse() @ WORLD_MAP
    speed = pose_at(index).inverse().rotation() @ (1.0, 0, 0)
    returns = np.column_stack([points_ego, np.full(len(points_ego), index)]).astype(np.float32)
    detections = np.column_stack([points_ego, np.full(len(points_ego), 3.0), np.tile(speed[:2], (len(points_ego), 1))])
    labels = np.random.default_rng(index).integers(0, 4, (256, 256, 32)).astype(np.uint8)
    labels[:9] = 255
    picture = PictureRecord(jpeg_of(index), MATRIX, AHEAD)
    at = (f"{sequence}{index}", sequence, index * STEP_US, pose_at(index))
    return FrameRecord(*at, returns, detections.astype(np.float32), (picture,), labels)


def jpeg_of(seed: int) -> bytes:
    v, u = np.mgrid[0:24, 0:32]
    pixels = np.stack([8 * u, 10 * v, 4 * (u + v) + seed], axis=-1).astype(np.uint8)
    file = BytesIO()
    Image.fromarray(pixels).save(file, "JPEG", quality=100, subsampling=0)
    return file.getvalue()


RECORDS = tuple(record_at(index) for index in range(6))


def dataset(records: tuple[FrameRecord, ...] = RECORDS, augment: AugmentConfig = NO_AUGMENTATION, seed: int = 0,
            inputs: InputConfig = INPUTS, lattice: VoxelLattice = SMALL) -> FrameDataset:  # fmt: skip
    return FrameDataset(Frames(records), FrameRequest(inputs, lattice, augment, seed, "observed"))


def same(one: Batch, other: Batch) -> bool:
    """Whether all tensors are equal, bit by bit."""
    pairs = (
        (one.cameras.images, other.cameras.images),
        (one.cameras.augmented_from_image, other.cameras.augmented_from_image),
        (one.lidar.features, other.lidar.features),
        (one.radar.features, other.radar.features),
        (one.labels, other.labels),
        (one.grid_from_ego, other.grid_from_ego),
    )
    return all(torch.equal(a, b) for a, b in pairs)


def test_a_point_that_stands_still_is_in_one_voxel_from_all_sweeps() -> None:
    batch = dataset()[0, 5]
    sweeps = batch.lidar.features.reshape(4, -1, 5)
    for sweep in sweeps[1:]:
        torch.testing.assert_close(sweep[:, :3], sweeps[0, :, :3], rtol=0, atol=2e-6)
    assert sweeps[:, 0, 3].tolist() == [5, 4, 3, 2]  # whose intensity says which sweep it is of
    torch.testing.assert_close(sweeps[:, 0, 4], torch.tensor([0, 0.1, 0.2, 0.3]))


def test_detections_come_in_where_they_were_with_velocities_turned() -> None:
    batch = dataset()[0, 5]
    scans = batch.radar.features.reshape(3, -1, 7)
    for scan in scans[1:]:
        torch.testing.assert_close(scan[:, :4], scans[0, :, :4], rtol=0, atol=2e-6)
        # A rate along a ray in plan has no part across it, so roll and pitch cost a little.
        torch.testing.assert_close(scan[:, 4:6], scans[0, :, 4:6], rtol=0, atol=2e-2)
    torch.testing.assert_close(scans[:, 0, 6], torch.tensor([0, 0.1, 0.2]))


def test_nothing_later_changes_anything() -> None:
    whole, cut = dataset(), dataset(RECORDS[:4])
    changed = dataset((*RECORDS[:4], *(record_at(index + 7) for index in (4, 5))))
    for index in range(4):
        assert same(whole[0, index], cut[0, index])
        assert same(whole[0, index], changed[0, index])


def test_every_earlier_sweep_changes_something() -> None:
    for index in (2, 3, 4):
        darker = replace(RECORDS[index], returns=RECORDS[index].returns * np.float32([1, 1, 1, 0]))
        assert not same(dataset((*RECORDS[:index], darker, *RECORDS[index + 1 :]))[0, 5], dataset()[0, 5])


def test_sequences_never_mix() -> None:
    other = tuple(record_at(index, "b") for index in range(3))
    both = dataset((*RECORDS, *other))
    for index in range(3):
        assert same(both[0, 6 + index], dataset(other)[0, index])


def test_sweeps_that_are_too_old_stay_out() -> None:
    batch = dataset(inputs=replace(INPUTS, earliest_s=0.15))[0, 5]
    assert batch.lidar.features[:, 4].unique().tolist() == pytest.approx([0, 0.1])


def test_a_modality_has_its_own_sensors_only() -> None:
    batch = dataset(inputs=InputConfig("R"))[0, 2]
    assert batch.cameras is None
    assert batch.lidar is None
    assert batch.radar is not None


@pytest.mark.parametrize("index", range(3))
def test_mirrored_points_and_labels_agree_voxel_by_voxel(index: int) -> None:
    """Also where the lattice is no symmetric part of the grid."""
    for lattice in (SMALL, VoxelLattice((-1.2, -3.2, -1.2), shape=(24, 20, 16))):
        for mirror_x, mirror_y in ((0, 1), (1, 0), (1, 1)):
            mirrored = dataset(augment=AugmentConfig(0, 0, 0, 0, mirror_x, mirror_y), lattice=lattice)[0, index]
            plain = dataset(lattice=VoxelLattice())[0, index]
            places, is_in = lattice.indices_of(mirrored.lidar.features[:, :3] + 1e-4)
            before, is_near = VoxelLattice().indices_of(
                plain.lidar.features[:, :3] + 1e-4 * mirrored.grid_from_ego[0].diagonal()[:3]
            )
            assert is_near.all()
            assert is_in.sum() > 10
            assert torch.equal(mirrored.labels[0][places[is_in].unbind(1)], plain.labels[0][before[is_in].unbind(1)])


def test_mirrored_velocities_point_where_points_move() -> None:
    plain, mirrored = dataset()[0, 1], dataset(augment=ALL)[0, 1]
    assert torch.equal(mirrored.radar.features[:, 4:6], -plain.radar.features[:, 4:6])
    assert torch.equal(mirrored.radar.features[:, :2], -plain.radar.features[:, :2])
    assert mirrored.grid_from_ego[0].diagonal().tolist() == [-1, -1, 1, 1]


def test_a_batch_has_memory_of_its_own() -> None:
    """On the whole grid too, where nothing is cut: frames stay in memory for those after them."""
    frames = dataset(lattice=VoxelLattice())
    frames.store.records[1].labels.flags.writeable = False  # type: ignore[attr-defined]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        first = frames[0, 1]
    first.labels.zero_()
    first.lidar.features.zero_()
    assert same(frames[0, 1], dataset(lattice=VoxelLattice())[0, 1])


def test_draws_are_of_seed_epoch_and_frame_alone() -> None:
    augment = AugmentConfig()
    one, other = dataset(augment=augment, seed=3), dataset(augment=augment, seed=3)
    forwards = {index: one[2, index] for index in range(6)}
    torch.manual_seed(9)
    np.random.seed(9)  # what is global must not matter
    assert all(same(other[2, index], forwards[index]) for index in reversed(range(6)))
    for changed in (one[3, 4], dataset(augment=augment, seed=4)[2, 4]):
        assert not same(changed, forwards[4])


@settings(max_examples=25)
@given(seed=st.integers(0, 10**6))
def test_a_point_has_the_same_colour_after_its_picture_was_changed(seed: int) -> None:
    """At the pixel where `augmented_from_image` puts it."""
    change = draw_picture_change(AugmentConfig(), (24, 32), generator_of(seed, 0, 0))
    before, after = changed_picture(jpeg_of(0), np.eye(3)), changed_picture(jpeg_of(0), change)
    v, u = np.mgrid[4:20, 4:28]
    moved = change @ np.stack([u.ravel(), v.ravel(), np.ones(u.size)])
    is_in = (moved[0] > 1) & (moved[0] < 30) & (moved[1] > 1) & (moved[1] < 22)
    assert is_in.sum() > 100
    for place in np.flatnonzero(is_in):
        at = moved[:2, place]
        wanted, found = before[:, v.flat[place], u.flat[place]], bilinear(after, *at)
        deviation = np.abs(wanted - found) * IMAGENET_DEVIATION
        assert deviation.max() < 8, (at, deviation)


def bilinear(picture: NDArray[np.float32], u: float, v: float) -> NDArray[np.float32]:
    column, row = int(u), int(v)
    a, b = u - column, v - row
    above = (1 - a) * picture[:, row, column] + a * picture[:, row, column + 1]
    below = (1 - a) * picture[:, row + 1, column] + a * picture[:, row + 1, column + 1]
    mixed: NDArray[np.float32] = (1 - b) * above + b * below
    return mixed


def test_pictures_are_normalised_and_black_where_they_do_not_reach() -> None:
    plain = changed_picture(jpeg_of(0), np.eye(3))
    pixels = plain * np.array(IMAGENET_DEVIATION)[:, None, None] + np.array(IMAGENET_MEAN)[:, None, None]
    assert np.abs(pixels[0] - 8 * np.arange(32)).max() < 4
    out = changed_picture(jpeg_of(0), np.array([[1.0, 0, 40], [0, 1, 0], [0, 0, 1]]))
    np.testing.assert_allclose(out[:, 5, 5], -np.array(IMAGENET_MEAN) / IMAGENET_DEVIATION, rtol=1e-5)


def test_mirrors_are_their_own_inverse() -> None:
    labels = np.arange(24, dtype=np.uint8).reshape(4, 3, 2)
    for mirrors in (GridMirrors(), GridMirrors(True), GridMirrors(y=True), GridMirrors(True, True)):
        assert np.array_equal(mirrors.of_labels(mirrors.of_labels(labels)), labels)
        assert np.array_equal(mirrors.grid_from_ego() @ mirrors.grid_from_ego(), np.eye(4))


def test_depth_is_the_nearest_point_of_a_pixel() -> None:
    """Against a loop over points."""
    random = np.random.default_rng(2)
    points = random.uniform(-4, 4, (3000, 3)).astype(np.float32)
    change = draw_picture_change(AugmentConfig(), (24, 32), generator_of(1, 0, 0))
    image_from_camera, camera_from_ego = change @ MATRIX, np.linalg.inv(AHEAD)
    wanted = np.zeros((24, 32))
    for point in points.astype(np.float64):
        ray = camera_from_ego[:3, :3] @ point + camera_from_ego[:3, 3]
        if ray[2] > 0.1:
            u, v, w = image_from_camera @ ray
            column, row = round(u / w), round(v / w)
            if 0 <= column < 32 and 0 <= row < 24:
                wanted[row, column] = min(ray[2], wanted[row, column] or math.inf)
    found = depth_picture(points, image_from_camera, camera_from_ego, (24, 32))
    assert (found > 0).sum() > 100
    np.testing.assert_allclose(found, wanted, rtol=1e-5)


def test_depth_follows_the_change_of_its_picture() -> None:
    batch = dataset(augment=AugmentConfig())[1, 3]
    camera_from_ego = np.linalg.inv(AHEAD)
    matrix = batch.cameras.image_from_camera()[0, 0].double().numpy()
    wanted = depth_picture(RECORDS[3].returns[:, :3], matrix, camera_from_ego, (24, 32))
    assert (wanted > 0).sum() > 5
    assert ((batch.cameras.depth_m[0, 0].numpy() > 0) != (wanted > 0)).mean() < 0.02


def test_a_joined_batch_is_its_frames_one_after_another() -> None:
    parts = [dataset()[0, index] for index in (4, 1, 3)]
    whole = joined(parts)
    assert whole.tokens == ("a4", "a1", "a3")
    for place, part in enumerate(parts):
        assert torch.equal(whole.lidar.features[whole.lidar.frame == place], part.lidar.features)
        assert torch.equal(whole.radar.features[whole.radar.frame == place], part.radar.features)
        assert torch.equal(whole.labels[place], part.labels[0])
        assert torch.equal(whole.cameras.images[place], part.cameras.images[0])
        assert torch.equal(whole.cameras.depth_m[place], part.cameras.depth_m[0])
    assert (whole.lidar.frame.diff() >= 0).all()
    assert joined([dataset(inputs=InputConfig("L"))[0, 1]]).cameras is None


@given(frames=st.integers(0, 60), world=st.integers(1, 7), seed=st.none() | st.integers(0, 99), epoch=st.integers(0, 3))
def test_shares_of_an_epoch_are_disjoint_and_equal(frames: int, world: int, seed: int | None, epoch: int) -> None:
    indices = [3 * index for index in range(frames)]
    shares = []
    for rank in range(world):
        sampler = EpochSampler(indices, seed, (rank, world))
        sampler.epoch = epoch
        drawn = list(sampler)
        assert len(drawn) == len(sampler) == frames // world
        assert all(of == epoch for of, _ in drawn)
        shares += [index for _, index in drawn]
        sampler.begin = len(drawn) // 2
        assert list(sampler) == drawn[len(drawn) // 2 :]
    assert len(set(shares)) == len(shares)
    assert set(shares) <= set(indices)


def test_epochs_have_other_orders() -> None:
    sampler = EpochSampler(range(20), 1)
    orders = []
    for sampler.epoch in range(3):
        orders.append([index for _, index in sampler])  # the sampler is told each epoch
    assert len({tuple(order) for order in orders}) == 3
    assert all(sorted(order) == list(range(20)) for order in orders)
    assert [index for _, index in EpochSampler(range(5))] == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    "lattice",
    [
        VoxelLattice((-26.0, -3.2, -1.2), shape=(32, 32, 16)),
        VoxelLattice((22.4, -3.2, -1.2), shape=(32, 32, 16)),
        VoxelLattice((-3.2, -3.2, -1.2), (0.4, 0.4, 0.4), (16, 16, 8)),
    ],
)
def test_a_lattice_that_is_no_part_of_the_grid_is_refused(lattice: VoxelLattice) -> None:
    with pytest.raises(ValueError, match="is not part of the grid paper"):
        grid_part(lattice, PAPER)


CPU = (torch.device("cpu"), "float32")


def one_hot(labels: Tensor) -> Tensor:
    return torch.nn.functional.one_hot(labels.long().clamp(max=3), 4).movedim(-1, 1).float()


class Oracle(OccupancyModel[Tensor]):
    """Answers the labels that it is given, or free."""

    def __init__(self, knows: bool = True) -> None:
        super().__init__()
        self.lattice, self.modality, self.knows = SMALL, "L", knows

    def forward(self, batch: Batch) -> Tensor:
        assert not self.training
        return one_hot(batch.labels * self.knows)

    def losses(self, outputs: Tensor, batch: Batch) -> dict[str, Tensor]:
        return {}

    def logits(self, outputs: Tensor, batch: Batch) -> Tensor:
        return outputs


def lidar_dataset(**changes: Any) -> FrameDataset:
    return FrameDataset(Frames(RECORDS), FrameRequest(InputConfig("L"), SMALL, **changes))


def test_a_confusion_is_a_loop_over_voxels() -> None:
    random = np.random.default_rng(1)
    labels = random.choice(np.array([0, 1, 2, 3, 255], np.uint8), (2, 4, 3, 5))
    logits = torch.from_numpy(random.normal(size=(2, 4, 4, 3, 5)))
    wanted = np.zeros((4, 4), np.int64)
    for frame, x, y, z in np.ndindex(labels.shape):
        if labels[frame, x, y, z] != 255:
            wanted[labels[frame, x, y, z], int(logits[frame, :, x, y, z].argmax())] += 1
    assert np.array_equal(confusion_of(logits, torch.from_numpy(labels)), wanted)


def test_of_equal_logits_the_first_class_is_taken() -> None:
    logits = torch.from_numpy(np.random.default_rng(2).integers(0, 3, (2, 4, 5, 6, 7))).float()
    logits[0, :, 0, 0] = -torch.inf
    classes = likeliest(logits)
    assert classes.dtype == torch.uint8
    assert np.array_equal(classes.numpy(), logits.numpy().argmax(axis=1))


def test_true_predictions_score_one_and_free_ones_nothing() -> None:
    targets = range(3)
    assert scores_on(Oracle().train(), lidar_dataset(), targets, CPU) == dict.fromkeys(RATIOS, 1.0)
    assert scores_on(Oracle(knows=False), lidar_dataset(), targets, CPU)["miou"] == 0


@pytest.mark.parametrize("trains", [True, False])
def test_a_model_is_left_in_the_mode_it_was_in(trains: bool) -> None:
    model = Oracle().train(trains)
    scores_on(model, lidar_dataset(), [0], CPU)
    assert model.training == trains


def test_what_nobody_observed_counts_as_free_or_not_at_all() -> None:
    lattice = replace(VoxelLattice(), shape=(16, 16, 8))  # a corner of the grid, of which nine rows were not observed
    request = FrameRequest(InputConfig("L"), lattice)
    both = [
        FrameDataset(Frames(RECORDS), replace(request, counted=counted))[0, 0].labels for counted in ("all", "observed")
    ]
    assert all(labels is not None for labels in both)
    everywhere, observed = (labels[0] for labels in both if labels is not None)
    assert not everywhere[:9].any()
    assert (observed[:9] == 255).all()
    assert torch.equal(everywhere[9:], observed[9:])
