"""The drive that the cases of `testing.worlds.field` alter is sound: nothing is refused, and equal drives are equal."""

from pathlib import Path

import pytest

from testing.worlds.field.drive import BEGIN_S, FieldDrive
from testing.worlds.field.outcome import labelled_frames, occupied_iou, outcome_of


def test_a_sound_drive_is_labelled_in_all_its_frames(tmp_path: Path) -> None:
    drive = FieldDrive()
    run, calibration = drive.write(tmp_path, drive.lidar_topic(), drive.odometry_topic())
    found = outcome_of(run, calibration, tmp_path / "labels")
    assert found.refusal == ""
    assert not found.errors
    frames = labelled_frames(tmp_path / "labels")
    assert len(frames) == 40
    assert next(iter(frames)) == round(BEGIN_S * 1e9)
    assert occupied_iou(tmp_path / "labels", tmp_path / "labels") == pytest.approx(1.0)
