"""`benchmarks.release` finds the settings that released labels were made with, and names what is missing."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.release.__main__ import compare
from benchmarks.release.pairs import bags_in, dataset_in, matched, paired
from benchmarks.release.search import Agreement, Kept, Searched, Setting
from benchmarks.release.table import ordered, ways_to_differ
from services.domain.viewer.frame_picture import comparison_picture
from services.labeler.parameters import chosen_parameters
from simulator.options import SimulateOptions
from stone_base.label_grid import RELEASE
from stone_files.grid_file import read_grid_file
from testing.refusals import refused_as
from testing.worlds.release_bags import RELEASED
from testing.worlds.released_pairs import MadePair, make_pair

DRIVE = SimulateOptions(seconds=2.0, seed=3, channels=16, columns=240, cameras=False, world_width_m=30.0)
MADE_WITH = Setting("paper", 20, 0.01)
NEAR = Kept(0.4)
UNKNOWN = 255


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> MadePair:
    parameters = chosen_parameters(MADE_WITH.profile, MADE_WITH.choices)
    return make_pair(tmp_path_factory.mktemp("release") / "farm_rosbag", DRIVE, parameters)


@pytest.fixture
def folder(made: MadePair, tmp_path: Path) -> Path:
    """Where the bag lies alone."""
    (tmp_path / "release").mkdir()
    shutil.copytree(made.bag, tmp_path / "release" / made.bag.name)
    return tmp_path / "release"


def near_own_sweep(labels: NDArray[np.uint8], returns_ego: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Labels of which only those voxels are known that have a return within 0.4 m of their centre."""
    places = np.argwhere((labels > 0) & (labels < UNKNOWN))
    centres = np.array(RELEASE.min_m) + (places + 0.5) * RELEASE.voxel_m
    away_m = np.array([np.linalg.norm(returns_ego - centre, axis=1).min() for centre in centres])
    far = places[away_m > 0.4]
    kept = labels.copy()
    kept[tuple(far.T)] = UNKNOWN
    return kept


def test_the_setting_that_made_the_labels_is_the_closest_and_its_labels_are_the_same(
    made: MadePair, folder: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    made.write_zip(folder / "STONE.zip")
    (folder / "cut.mcap").write_bytes(b"\x89MCAP0\r\n")
    searched = Searched(("field", "local", "paper"), (20, 10), (0.05, 0.01), (NEAR, Kept()))
    found = compare(folder, searched, tmp_path / "out", 1)
    (first, closest), (_, second), *_ = ordered(found)
    assert len(found) == 3 * 2 * 2 * 2
    assert first == MADE_WITH
    assert closest.ratios == [1.0] * 5
    assert second.ratios[-1] < 0.99
    known = made.labels[(made.labels > 0) & (made.labels < UNKNOWN)]
    np.testing.assert_array_equal(np.diag(closest.confusion.sum(axis=0))[1:], np.bincount(known)[1:])
    assert closest.beyond == 0
    said = capfd.readouterr()
    frames, released = len(made.sequence.frames), len(made.labels)
    assert f"{released} of {frames} frames have released labels ({released} by equal stamps" in said.out
    assert re.search(r"origin is 0\.(39|40|41|42) m above the ground", said.out)
    assert "warning CAL-438" in said.out
    assert "warning LAB-601" in said.out, "what labelling notices is there, not what the bag alone shows"
    assert "--profile paper --parameter terrain.neighbours=20 --parameter reference.alpha=0.01" in said.out
    assert "cut.mcap is skipped: BAG-" in said.err
    grid = read_grid_file(tmp_path / "out" / "farm_rosbag.grid.json")
    assert grid.shape == RELEASE.shape
    assert grid.min_m == pytest.approx((-40, -40, RELEASE.min_m[2] + RELEASED.ego_height_m), abs=0.02)
    labels = made.labels[released // 2]
    alike = (np.where(labels == UNKNOWN, 0, labels).astype(np.uint8), (labels < UNKNOWN).astype(np.uint8))
    assert (tmp_path / "out" / "farm_rosbag.png").read_bytes() == comparison_picture(alike, alike)


@pytest.mark.release
def test_voxels_near_the_own_sweep_are_found_to_be_all_that_is_known_over_two_bags_with_late_stamps(
    made: MadePair, folder: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """If the release knows no other voxels, all settings agree, and those that label nothing else come first.

    Catches alone a search that misses the sweep by late stamps or by a second bag.
    """
    released = list[NDArray[np.uint8]]()

    def change(labels: NDArray[np.uint8], returns_ego: NDArray[np.float64]) -> NDArray[np.uint8]:
        released.append(near_own_sweep(labels, returns_ego))
        return released[-1]

    made.write_zip(folder / "STONE.zip", change, late_us=1500)
    shutil.copytree(made.bag, folder / "bags" / "again")
    settings = Searched(("paper",), (20,), (0.01,), (Kept(), Kept(0.4, 3), NEAR))
    found = compare(folder, settings, tmp_path / "out", 1)
    assert [one.kept for one, _ in ordered(found)] == [NEAR, Kept(0.4, 3), Kept()]
    assert all(agreement.ratios == [1.0] * 5 for agreement in found.values())
    beyond = [agreement.beyond for _, agreement in ordered(found)]
    assert beyond[0] == 0 < beyond[1] < beyond[2]
    near = sum(np.count_nonzero((labels > 0) & (labels < UNKNOWN)) for labels in released)
    assert found[Setting("paper", 20, 0.01, NEAR)].labelled == 2 * near
    assert "0 by equal stamps, the others at most 1.500 ms off" in capfd.readouterr().out


def test_a_folder_without_dataset_or_bag_and_a_bag_of_another_time_are_refused_by_what_is_missing(
    made: MadePair, folder: Path, tmp_path: Path
) -> None:
    with refused_as("no_release", match="is not an existing folder"):
        dataset_in(tmp_path / "nowhere")
    with refused_as("no_release", match="contains no dataset: put the released ZIP"):
        dataset_in(folder)
    made.write_zip(tmp_path / "STONE.zip", late_us=3_600_000_000)
    shutil.copy(tmp_path / "STONE.zip", folder)
    with refused_as("no_release", match=r"none of its \d+ frames has .* nearest released frame is 359\d\.\d+ s"):
        compare(folder, Searched(("paper",), (20,), (0.05,), (Kept(),)), tmp_path / "out", 1)
    shutil.rmtree(folder / made.bag.name)
    with refused_as("no_release", match="contains no bag"):
        bags_in(folder)


def test_scenes_of_one_bag_with_two_mounts_are_refused(made: MadePair, folder: Path, tmp_path: Path) -> None:
    made.write_zip(folder / "STONE.zip", turned_scenes=1)
    with refused_as("no_release", match="have 2 mounts of LIDAR_TOP"):
        paired(folder / made.bag.name, dataset_in(folder), tmp_path)


def test_stamps_match_within_five_milliseconds_whatever_their_order() -> None:
    theirs = np.array([300, 100, 200, 900]) * 1_000_000
    ours = np.array([0, 95, 104, 206, 304, 905, 1000]) * 1_000_000
    rows, places = matched(ours, theirs)
    assert (rows.tolist(), places.tolist()) == ([1, 2, 4, 5], [1, 1, 0, 3])
    assert matched(ours, theirs[:1])[0].tolist() == [4]


def test_differences_are_named_from_our_side() -> None:
    """Rows are theirs: two voxels that they call T and we N are easier in theirs, B."""
    confusion = np.zeros((4, 4), np.int64)
    confusion[0, 0], confusion[1, 3], confusion[3, 1], confusion[0, 2], confusion[2, 0], confusion[2, 2] = (
        99,
        2,
        1,
        3,
        4,
        10,
    )
    shares = ways_to_differ(confusion)
    assert shares == {"same class": 0.5, "only in A": 0.15, "only in B": 0.2, "easier in B": 0.1, "harder in B": 0.05}


def test_a_setting_whose_ratio_is_undefined_comes_last() -> None:
    nothing = np.zeros((3, 4, 4), np.int64)
    half = nothing.copy()
    half[0, 1:, 1:] = 1
    found = {Setting("paper", 20, 0.01): Agreement(nothing, 0, 0), Setting("field", 20, 0.01): Agreement(half, 5, 9)}
    assert ordered(found)[0][0].profile == "field"
