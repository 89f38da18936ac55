"""A recording opened as a sequence, at once or with its checks beside."""

import shutil
from pathlib import Path

import pytest

from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sequence import OpenedSequence, open_sequence, opened_sequence, with_sequence
from services.labeler.errors import no_usable_frames
from services.labeler.local_run import LabelOptions, label
from services.labeler.report import LabelReport
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from stone.errors import StoneError
from stone.findings import Finding
from stone_recordings.bags.bag import Bag
from stone_recordings.bags.errors import ChecksumError
from stone_recordings.clocks import point_clock
from stone_recordings.sync import radar_check
from stone_recordings.sync.sequence_file import read_sequence
from testing.refusals import refused_as
from testing.worlds.drives import SEEN_BY_CAMERAS, drive
from testing.worlds.faults.other_edits import bad_checksum, bad_chunk

SEEN = Finding("CAL-404", "warning", "CAM_FRONT", "its mount is not this camera's")


@pytest.fixture
def recorded(tmp_path_factory: pytest.TempPathFactory, tmp_path: Path) -> Path:
    """A recording of the test's own."""
    bag = drive(tmp_path_factory, SEEN_BY_CAMERAS)
    shutil.copyfile(calibration_path(bag), calibration_path(tmp_path / bag.name))
    return shutil.copyfile(bag, tmp_path / bag.name)


@pytest.mark.whole
def test_what_is_found_late_follows_what_is_found_at_once_in_the_labels_too(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches alone findings of the late checks that labels lack, or tell in another order."""
    monkeypatch.setattr("services.ingest.pipeline.projection_findings", lambda *_: (SEEN,))
    bag, calibration = recorded, calibration_path(recorded)
    whole, _ = open_sequence(bag, calibration, "run")
    with opened_sequence(bag, calibration, "run", SynchroniseOptions()) as opened:
        at_once, late = opened.sequence.findings, opened.late_findings()
        options = LabelOptions(late_findings=opened.late_findings)
        label(opened.sequence, opened.sweeps, tmp_path / "labels", options)
    assert SEEN in late
    assert SEEN not in at_once
    assert (*at_once, *late) == whole.findings
    assert read_sequence((tmp_path / "labels" / "sequence.npz").read_bytes()).findings == whole.findings


@pytest.mark.whole
def test_a_recording_that_is_believed_and_damaged_is_labelled_as_one_that_was_checked_first(
    recorded: Path, tmp_path: Path
) -> None:
    """Catches alone labels that differ because damage was found while they were made, and not before."""
    bag, calibration = recorded, calibration_path(recorded)
    bad_chunk(bag)
    checked, _ = open_sequence(bag, calibration, "run")

    def labelled(opened: OpenedSequence) -> LabelReport:
        options = LabelOptions(late_findings=opened.late_findings)
        return label(opened.sequence, opened.sweeps, tmp_path / "labels", options)

    report = with_sequence(bag, calibration, "run", SynchroniseOptions(), labelled)
    assert len(checked.excluded) > 0
    assert report.sequence.excluded == checked.excluded
    assert report.sequence.findings == checked.findings
    assert "BAG-016" in {finding.code for finding in checked.findings}


@pytest.mark.whole
def test_damage_where_no_sweep_lies_is_found_late_and_a_sound_recording_is_opened_once(
    recorded: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag, calibration = recorded, calibration_path(recorded)

    def late(opened: OpenedSequence) -> bool:
        opened.late_findings()
        return opened.sequence.excluded == ()

    believed = list[Bag]()
    monkeypatch.setattr(Bag, "believe", lambda self: believed.append(self) or setattr(self, "is_believed", True))
    assert with_sequence(bag, calibration, "run", SynchroniseOptions(), late)
    monkeypatch.setattr(Bag, "damaged_beside", lambda *_: {"/imu/data": {0: "chunk 1"}})
    monkeypatch.setattr(Bag, "damaged", {"/imu/data": {0: "chunk 1"}})
    assert with_sequence(bag, calibration, "run", SynchroniseOptions(), late)
    assert len(believed) == 2


@pytest.mark.whole
def test_a_chunk_that_a_worker_finds_damaged_while_it_fuses_is_left_out_the_second_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches alone labels that fail, or lack a finding, where the heads of a chunk are sound and its sweep is not.

    Few sweeps and no scans are looked at before, so that none is of that chunk.
    """
    monkeypatch.setattr(point_clock, "SWEEP_SAMPLES", 5)
    monkeypatch.setattr(radar_check, "MOST_TRIED", 1)
    bag, calibration = tmp_path / "run.mcap", calibration_path(tmp_path / "run.mcap")
    simulate(
        bag, SimulateOptions(1.2, channels=128, columns=1200, camera_width_px=64, world_width_m=30.0, speed_m_s=3.0)
    )
    bad_checksum(bag)
    checked, _ = open_sequence(bag, calibration, "run")
    refused = list[StoneError]()

    def labelled(opened: OpenedSequence) -> LabelReport:
        options = LabelOptions(workers=2, late_findings=opened.late_findings)
        try:
            return label(opened.sequence, opened.sweeps, tmp_path / "labels", options)
        except StoneError as error:
            refused.append(error)
            raise

    report = with_sequence(bag, calibration, "run", SynchroniseOptions(), labelled)
    assert [type(error) for error in refused] == [ChecksumError]
    assert len(checked.excluded) == 1
    assert report.sequence.excluded == checked.excluded
    assert report.sequence.findings == checked.findings


def test_what_fails_of_a_sound_recording_fails_once(recorded: Path) -> None:
    bag, calibration = recorded, calibration_path(recorded)
    tries = list[OpenedSequence]()

    def fails(opened: OpenedSequence) -> None:
        tries.append(opened)
        raise no_usable_frames(opened.sequence)

    with refused_as("no_frames"):
        with_sequence(bag, calibration, "run", SynchroniseOptions(), fails)
    assert len(tries) == 1
