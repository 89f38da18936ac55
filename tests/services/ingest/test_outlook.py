"""Whatever labelling refuses or leaves out, inspection has named, over the fault catalogue."""

import re
from pathlib import Path

import pytest

from services.ingest.outlook import inspected_in, outlook, with_new
from services.ingest.pipeline import SynchroniseOptions, synchronise
from stone.errors import StoneError
from stone.findings import Finding
from stone_recordings.bags.bag import open_bag
from testing.worlds.faults.catalogue import FAULTS
from testing.worlds.faults.drive import SoundDrive, faulty, kitti_drive, simulated_drive
from testing.worlds.faults.fault import RecordingFault

BY_NAME = {fault.name: fault for fault in FAULTS}
EVERY_DAY = (
    "one pose 30 m off",
    "one pose message garbage",
    "every tenth pose recorded",
    "the same INS solution for ever",
    "one cloud cut",
    "every cloud all NaN",
    "one sweep stamped 1 s back",
    "one radar message cut",
    "one picture garbage",
    "a plain chunk with a bad CRC",
)
# What two sides of a break have to do with each other, where ground and mounts are, and whether poses and sweeps are of
# one time, is told where sweeps are looked at.
OF_SWEEPS = {"SYN-507", "SYN-508", "SYN-514", "SYN-515", "TIM-205", "TIM-213", "MSG-306"}


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> SoundDrive:
    return simulated_drive(tmp_path_factory.mktemp("simulated"))


@pytest.fixture(scope="module")
def kitti(field_data: Path, tmp_path_factory: pytest.TempPathFactory) -> SoundDrive:
    return kitti_drive(field_data, tmp_path_factory.mktemp("kitti"))


def refused_or_found(bag: Path, drive: SoundDrive, fault: RecordingFault) -> tuple[set[str], int]:
    """The codes that synchronisation gives, the refusal's alone where it refuses; and how many sweeps are left out."""
    try:
        sequence, _ = synchronise(bag, drive.rig(fault), SynchroniseOptions(), "run")
    except StoneError as refusal:
        return {refusal.code}, 0
    return {finding.code for finding in sequence.findings}, len(sequence.excluded)


def check(drive: SoundDrive, fault: RecordingFault, folder: Path) -> None:
    bag = faulty(drive, fault, folder / "run.mcap")
    found, excluded = refused_or_found(bag, drive, fault)
    try:
        with open_bag(bag) as opened:
            named = {finding.code for finding in inspected_in(opened).findings}
    except StoneError as refusal:
        named = {refusal.code}
    assert {code for code in found if not code.startswith("CAL-")} - OF_SWEEPS <= named
    assert not excluded or "SYN-501" in named


@pytest.mark.parametrize("name", EVERY_DAY)
def test_a_plain_inspection_names_what_labelling_will_do(simulated: SoundDrive, tmp_path: Path, name: str) -> None:
    check(simulated, BY_NAME[name], tmp_path)


@pytest.mark.whole
@pytest.mark.parametrize("which", ["simulated", "kitti"])
def test_whatever_is_refused_or_left_out_was_named(which: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    """Catches alone a fault of one kind of message that inspection and labelling see differently."""
    drive: SoundDrive = request.getfixturevalue(which)
    faults = [fault for fault in FAULTS if drive.has(fault)]
    assert len(faults) >= 40
    for fault in faults:
        check(drive, fault, tmp_path)


def test_with_a_calibration_the_mounts_are_looked_at_too(simulated: SoundDrive) -> None:
    lower = BY_NAME["LiDAR entered 23 cm low"]
    with open_bag(simulated.bag) as bag:
        assert "CAL-433" in {finding.code for finding in outlook(bag, simulated.rig(lower), SynchroniseOptions())}
        assert outlook(bag, None, SynchroniseOptions()) == ()
        assert inspected_in(bag, calibration=simulated.calibration).findings == ()


# The simulated LiDAR stamps every point: a late header does not move them.
@pytest.mark.parametrize(
    ("which", "name"),
    [
        ("simulated", "poses 0.1 s late"),
        pytest.param("kitti", "poses 0.1 s late", marks=pytest.mark.whole),
        pytest.param("kitti", "sweeps 0.1 s late", marks=pytest.mark.whole),
    ],
)
def test_poses_and_sweeps_of_two_times_are_named_with_what_puts_them_right(
    which: str, name: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    """Catches alone, on the real drive, that its sweeps are not registered well enough to tell."""
    drive: SoundDrive = request.getfixturevalue(which)
    with open_bag(faulty(drive, BY_NAME[name], tmp_path / "run.mcap")) as bag:
        (late,) = [one for one in inspected_in(bag, calibration=drive.calibration).findings if one.code == "TIM-213"]
    words = re.search(r"stamps of the (\w+) are about (\d+) ms later", late.message)
    assert words is not None
    assert words[1] == name.split()[0]
    assert 70 <= int(words[2]) <= 120
    with open_bag(drive.bag) as bag:
        sound = inspected_in(bag, calibration=drive.calibration).findings
    assert "TIM-213" not in {one.code for one in sound}


def test_a_refusal_is_an_error_where_no_calibration_can_avert_it(simulated: SoundDrive, tmp_path: Path) -> None:
    bag = faulty(simulated, BY_NAME["every position NaN"], tmp_path / "run.mcap")
    with open_bag(bag) as opened:
        severities = [
            [(one.code, one.severity) for one in outlook(opened, rig, SynchroniseOptions())]
            for rig in (None, simulated.rig())
        ]
    assert severities == [[("SYN-503", "warning")], [("SYN-503", "error")]]


def test_nothing_is_said_twice() -> None:
    known = (Finding("TOP-101", "error", "", "none"), Finding("TIM-203", "warning", "/a", "back"))
    again = (Finding("TOP-101", "error", "", "no LiDAR"), Finding("TIM-203", "warning", "/a", "sorted"))
    new = (Finding("TIM-203", "warning", "/b", "sorted"), Finding("SYN-501", "warning", "", "few"))
    assert with_new(known, again + new) == known + new
