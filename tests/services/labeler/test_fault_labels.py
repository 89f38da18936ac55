"""Labels of faulty drives: nothing is driven on beyond the footprint of a pose, and no fault ends without a code.

Catches alone a fault that goes through synchronisation and makes wrong ground truth: `make bench-faults` has them all.
"""

from pathlib import Path

import pytest

from testing.worlds.drives import sound_drive
from testing.worlds.faults.catalogue import FAULTS
from testing.worlds.faults.drive import SoundDrive, kitti_drive
from testing.worlds.faults.outcome import LabelledDrive, outcome, sound

pytestmark = pytest.mark.whole

BY_NAME = {fault.name: fault for fault in FAULTS}
LABELLED = (
    ("simulated", "poses jump 30 m in the middle"),
    ("simulated", "poses silent for a third"),
    ("simulated", "one pose stamped 0"),
    ("simulated", "one cloud of another sensor"),
    ("simulated", "a plain chunk with a bad CRC"),
    ("kitti", "poses jump 30 m in the middle"),
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
def drive(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Sound:
    folder = tmp_path_factory.mktemp("drive")
    is_simulated = request.param == "simulated"
    made = sound_drive(tmp_path_factory) if is_simulated else kitti_drive(request.getfixturevalue("field_data"), folder)
    return made, sound(made, folder / "labels")


@pytest.mark.parametrize(("drive", "name"), LABELLED, indirect=["drive"])
def test_nothing_is_driven_on_beyond_the_footprint_of_a_pose(drive: Sound, tmp_path: Path, name: str) -> None:
    whole, labelled = drive
    found = outcome(whole, BY_NAME[name], tmp_path, labelled.grids)
    assert (found.refusal, found.beyond) == ("", 0)
    assert found.driven > 0
    assert not found.excluded or "SYN-501" in found.named
    shares = labelled.report.class_shares()
    assert found.p_share == pytest.approx(shares["potentially_traversable"], abs=0.12)


@pytest.mark.parametrize(("drive", "name"), list(REFUSED), indirect=["drive"])
def test_what_cannot_be_labelled_is_refused_and_was_named(drive: Sound, tmp_path: Path, name: str) -> None:
    whole, labelled = drive
    found = outcome(whole, BY_NAME[name], tmp_path, labelled.grids)
    assert found.refusal == REFUSED[whole.name, name]
    assert found.refusal in found.named or "CAL-433" in found.named
