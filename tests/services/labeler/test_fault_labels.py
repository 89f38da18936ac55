"""Labels of faulty drives: nothing is driven on beyond the footprint of a pose, and no fault ends without a code.

Catches alone a fault that goes through synchronisation and makes wrong ground truth: `make bench-faults` has them all,
`make check` the gravest one on a real drive.
"""

from pathlib import Path

import pytest

from testing.worlds.drives import sound_drive
from testing.worlds.faults.catalogue import FAULTS
from testing.worlds.faults.drive import SoundDrive, kitti_drive
from testing.worlds.faults.outcome import LabelledDrive, outcome, sound

pytestmark = pytest.mark.whole

BY_NAME = {fault.name: fault for fault in FAULTS}
GRAVEST = ("kitti", "poses jump 30 m in the middle")
LABELLED = (
    GRAVEST,
    ("simulated", "poses jump 30 m in the middle"),
    ("simulated", "poses silent for a third"),
    ("simulated", "one pose stamped 0"),
    ("simulated", "one cloud of another sensor"),
    ("simulated", "a plain chunk with a bad CRC"),
    ("kitti", "one pose 30 m off"),
    ("kitti", "one sweep stamped 1 s back"),
)
REFUSED = {
    ("simulated", "one pose recorded"): "SYN-503",
    ("simulated", "every cloud all NaN"): "SYN-509",
    ("kitti", "LiDAR entered upside down"): "footprint_off_ground",
}
Sound = tuple[SoundDrive, LabelledDrive]


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Sound:
    drive = sound_drive(tmp_path_factory)
    return drive, sound(drive, tmp_path_factory.mktemp("simulated") / "labels")


@pytest.fixture(scope="module")
def kitti(field_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Sound:
    folder = tmp_path_factory.mktemp("kitti")
    drive = kitti_drive(field_data, folder)
    return drive, sound(drive, folder / "labels")


@pytest.mark.parametrize(
    ("which", "name"),
    [pytest.param(*case, marks=() if case == GRAVEST else pytest.mark.release) for case in LABELLED],
)
def test_nothing_is_driven_on_beyond_the_footprint_of_a_pose(
    request: pytest.FixtureRequest, tmp_path: Path, which: str, name: str
) -> None:
    whole, labelled = request.getfixturevalue(which)
    found = outcome(whole, BY_NAME[name], tmp_path, labelled.grids)
    assert (found.refusal, found.beyond) == ("", 0)
    assert found.driven > 0
    assert not found.excluded or "SYN-501" in found.named
    shares = labelled.report.class_shares()
    assert found.p_share == pytest.approx(shares["potentially_traversable"], abs=0.12)


@pytest.mark.parametrize(("which", "name"), list(REFUSED))
def test_what_cannot_be_labelled_is_refused_and_was_named(
    request: pytest.FixtureRequest, tmp_path: Path, which: str, name: str
) -> None:
    whole, labelled = request.getfixturevalue(which)
    found = outcome(whole, BY_NAME[name], tmp_path, labelled.grids)
    assert found.refusal == REFUSED[which, name]
    assert found.refusal in found.named or "CAL-433" in found.named
