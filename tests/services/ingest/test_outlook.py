"""Whatever labelling refuses or leaves out, inspection has named, over the fault catalogue; an inspection with its
outlook reads a recording once, and says what two passes over it say."""

import re
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from services.ingest.pipeline import SynchroniseOptions, synchronise
from services.ingest.sandboxed_inspection import inspected_in, outlook, stood_in, with_new
from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from stone.errors import StoneError
from stone.findings import Finding
from stone_recordings.bags import chunked_store
from stone_recordings.bags.bag import open_bag
from stone_recordings.bags.chunks import Chunk, inflate
from stone_recordings.report.inspection import scanned
from stone_recordings.topics.sources import AskedTopics
from testing.worlds.drives import sound_drive
from testing.worlds.faults.catalogue import FAULTS
from testing.worlds.faults.drive import SoundDrive, faulty, kitti_drive
from testing.worlds.faults.fault import RecordingFault
from testing.worlds.field.drive import LIDAR_UP_M, FieldDrive, FieldTopic
from testing.worlds.field.outcome import outcome_of

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
OF_SWEEPS = {"SYN-507", "SYN-508", "SYN-514", "SYN-515", "SYN-518", "TIM-205", "TIM-213", "MSG-306"}


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> SoundDrive:
    return sound_drive(tmp_path_factory)


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


@pytest.mark.whole
@pytest.mark.parametrize("name", EVERY_DAY)
def test_a_plain_inspection_names_what_labelling_will_do(simulated: SoundDrive, tmp_path: Path, name: str) -> None:
    check(simulated, BY_NAME[name], tmp_path)


@pytest.mark.release
@pytest.mark.parametrize("which", ["simulated", "kitti"])
def test_whatever_is_refused_or_left_out_was_named(which: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    """Catches alone a fault of one kind of message that inspection and labelling see differently; on the real drive of
    poses, which it has as odometry."""
    drive: SoundDrive = request.getfixturevalue(which)
    faults = [fault for fault in FAULTS if drive.has(fault) and (which == "simulated" or fault.role == "pose")]
    assert len(faults) >= 30
    for fault in faults:
        if which != "simulated" or fault.name not in EVERY_DAY:
            check(drive, fault, tmp_path)


@pytest.mark.whole
def test_with_a_calibration_the_mounts_are_looked_at_too(simulated: SoundDrive) -> None:
    lower = BY_NAME["LiDAR entered 23 cm low"]
    with open_bag(simulated.bag) as bag:
        assert "CAL-433" in {finding.code for finding in outlook(bag, simulated.rig(lower), SynchroniseOptions())}
        assert stood_in(bag, SynchroniseOptions())[0] == ()
        assert inspected_in(bag, calibration=simulated.calibration).findings == ()


# The simulated LiDAR stamps every point: a late header does not move them.
@pytest.mark.parametrize(
    ("which", "name"),
    [
        ("simulated", "poses 0.1 s late"),
        pytest.param("kitti", "poses 0.1 s late", marks=pytest.mark.whole),
        pytest.param("kitti", "sweeps 0.1 s late", marks=pytest.mark.release),
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


def test_a_refusal_is_an_error_unless_what_averts_it_may_yet_be_brought(simulated: SoundDrive, tmp_path: Path) -> None:
    bag = faulty(simulated, BY_NAME["every position NaN"], tmp_path / "run.mcap")
    with open_bag(bag) as opened:
        said = (
            stood_in(opened, SynchroniseOptions(), "warning")[0],
            outlook(opened, simulated.rig(), SynchroniseOptions()),
        )
        severities = [[(one.code, one.severity) for one in found] for found in said]
    assert severities == [[("SYN-503", "warning")], [("SYN-503", "error")]]


def test_nothing_is_said_twice() -> None:
    known = (Finding("TOP-101", "error", "", "none"), Finding("TIM-203", "warning", "/a", "back"))
    again = (Finding("TOP-101", "error", "", "no LiDAR"), Finding("TIM-203", "warning", "/a", "sorted"))
    graver = Finding("TIM-203", "error", "", "refused")
    new = (Finding("TIM-203", "warning", "/b", "sorted"), Finding("SYN-501", "warning", "", "few"), graver)
    assert with_new(known, again + new) == known + new


@pytest.mark.whole
@pytest.mark.parametrize(
    "name", ["one pose message garbage", "one cloud cut", "a zstd chunk with a bad CRC", "tf_static cut"]
)
def test_one_pass_says_what_two_say(simulated: SoundDrive, tmp_path: Path, name: str) -> None:
    bag = faulty(simulated, BY_NAME[name], tmp_path / "run.mcap")
    with open_bag(bag) as opened:
        one = inspected_in(opened)
    with open_bag(bag) as opened:
        alone = scanned(opened)
        assert alone.recorded is None
        two = inspected_in(opened, scan=alone)
    assert one.as_record() == two.as_record()


@pytest.mark.whole
def test_every_chunk_is_inflated_once_but_those_of_clouds_that_are_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = tmp_path / "run.mcap"
    simulate(bag, SimulateOptions(seconds=5.0, channels=64, columns=720, cameras=False))
    times = Counter[int]()

    def counted(view: memoryview, chunk: Chunk) -> memoryview:
        times[chunk.start] += 1
        return inflate(view, chunk)

    monkeypatch.setattr(chunked_store, "inflate", counted)
    with open_bag(bag) as opened:
        inspected_in(opened)
    # Of a run 16 sweeps are looked at for the times of their points, 16 scans of radars, and 40 sweeps for the ground.
    again = times.total() - len(times)
    assert len(times) > 15
    assert again <= 3.2 * len(times), times


def test_topics_that_synchronisation_would_refuse_are_scanned_without_it(simulated: SoundDrive) -> None:
    with open_bag(simulated.bag) as bag:
        found = scanned(bag, AskedTopics(lidar="/nothing"))
        assert found.recorded is None
        assert found.stamps_ns.keys() == scanned(bag, AskedTopics()).stamps_ns.keys()
        assert scanned(bag, AskedTopics()).recorded is not None


def test_what_labelling_refuses_by_the_ground_is_an_error_of_the_inspection(tmp_path: Path) -> None:
    drive = FieldDrive()
    run, calibration = drive.write(tmp_path, drive.lidar_topic(), drive.odometry_topic())
    lower = tmp_path / "low.yaml"
    lower.write_text(calibration.read_text().replace(f"{LIDAR_UP_M}]", f"{LIDAR_UP_M - 0.4}]"))
    found = outcome_of(run, lower, tmp_path / "labels")
    assert (found.refusal, [one.code for one in found.errors]) == ("footprint_off_ground", ["footprint_off_ground"])


def test_ground_that_no_sweep_shows_under_the_robot_is_an_error_of_the_inspection(tmp_path: Path) -> None:
    """The returns nearer than the drive is long are missing, as behind a shroud."""
    drive = FieldDrive()

    def far(t: float) -> Any:
        points, after_s = drive.points(t)
        points["time"] = after_s
        return drive.cloud(t, points[np.hypot(points["x"], points["y"]) > 9.0])

    run, calibration = drive.write(tmp_path, FieldTopic("/points", 0.1, 0.0, far), drive.odometry_topic())
    found = outcome_of(run, calibration, tmp_path / "labels")
    assert (found.refusal, [one.code for one in found.errors]) == ("no_reference", ["no_reference"])
