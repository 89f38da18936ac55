"""What is exported of a recording is a sound dataset, whatever clock its stamps are of.

Catches alone a check that refuses the stamps of simulated time or of a clock that was never set.
"""

import tarfile
from pathlib import Path

import numpy as np
import pytest

from services.labeler.exports.folder import ExportRequest, export
from services.labeler.exports.source import folder_source, read_report
from services.labeler.imports.answers import DatasetIndexAnswer
from services.labeler.imports.indexing import index_dataset
from services.labeler.imports.scene_parts import DatasetOpening
from stone_datasets.classes import OWN_CLASSES
from stone_datasets.reading import check_dataset, read_dataset
from stone_exports.files import FolderFiles
from stone_exports.frames import frames_in
from stone_recordings.sync.samples import checked_samples
from testing.worlds.field.drive import BEGIN_S, FieldDrive
from testing.worlds.field.outcome import labelled_frames, outcome_of

# (where the stamps begin, from which second on the LiDAR records until as long before the end)
CLOCKS = {
    "a set clock": (BEGIN_S, 0.0),
    "simulated time": (0.4, 0.0),
    "simulated time from 0": (0.0, 0.0),
    "time since boot": (668.2, 0.0),
    "time since boot, of 11 days": (950_400.0, 0.0),
    "before 1970": (-3.0, 0.0),
    "one frame of simulated time": (0.4, 1.95),
    "one frame since boot": (668.2, 1.95),
    "two frames since boot": (1_668.2, 1.9),
}


@pytest.mark.parametrize("clock", CLOCKS)
def test_an_export_of_any_clock_is_a_sound_dataset(clock: str, tmp_path: Path) -> None:
    begin_s, after_s = CLOCKS[clock]
    drive = FieldDrive(begin_s, sweeps=40 if after_s else 16)
    lidar = drive.lidar_topic()._replace(lead_s=-after_s)
    run, calibration = drive.write(tmp_path, lidar, drive.odometry_topic())
    found = outcome_of(run, calibration, tmp_path / "labels")
    assert found.refusal == ""
    frames = list(labelled_frames(tmp_path / "labels"))
    for form in ("nuscenes", "inputs"):
        out = tmp_path / form
        request = ExportRequest(form, out, read_report(tmp_path / "labels"))
        export(request, lambda: folder_source(tmp_path / "labels", checked_samples, run), lambda *_: None)
        check = check_dataset(out)
        assert [str(fault) for fault in check.faults.found] == []
        assert check.contents is not None
        (sequence,) = check.contents.as_record()["sequences"]
        assert (sequence["frames"], sequence["is_dated"]) == (len(frames), begin_s == BEGIN_S)
        assert [frame.stamp_us for frame in frames_in(FolderFiles(out))] == [stamp // 1000 for stamp in frames]
    with tarfile.open(tmp_path / "export.tar", "w") as tar:
        tar.add(tmp_path / "nuscenes", "nuscenes")
    (tmp_path / "import").mkdir()
    opening = DatasetOpening(tmp_path / "export.tar", "export.tar", "0" * 64, OWN_CLASSES)
    answer = DatasetIndexAnswer.model_validate_json(index_dataset(opening, tmp_path / "import", lambda *_: None))
    assert [scene.frames for scene in answer.scenes] == [len(frames)]
    archived = read_dataset(tmp_path / "export.tar").sequences[0]
    assert np.array_equal(archived.stamps_ns // 1000, [stamp // 1000 for stamp in frames])
