"""A recording opened as a sequence, at once or with its checks beside."""

from pathlib import Path

import pytest

from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sequence import open_sequence, opened_sequence
from services.labeler.local_run import LabelOptions, label
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from stone.findings import Finding
from stone_recordings.sync.sequence_file import read_sequence

SEEN = Finding("CAL-404", "warning", "CAM_FRONT", "its mount is not this camera's")


def test_what_is_found_late_follows_what_is_found_at_once_in_the_labels_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("services.ingest.pipeline.projection_findings", lambda *_: (SEEN,))
    bag, calibration = tmp_path / "run.mcap", calibration_path(tmp_path / "run.mcap")
    simulate(bag, SimulateOptions(3.0, channels=16, columns=360, camera_width_px=64))
    whole, _ = open_sequence(bag, calibration, "run")
    with opened_sequence(bag, calibration, "run", SynchroniseOptions()) as opened:
        at_once, late = opened.sequence.findings, opened.late_findings()
        options = LabelOptions(late_findings=opened.late_findings)
        label(opened.sequence, opened.sweeps, tmp_path / "labels", options)
    assert SEEN in late
    assert SEEN not in at_once
    assert (*at_once, *late) == whole.findings
    assert read_sequence((tmp_path / "labels" / "sequence.npz").read_bytes()).findings == whole.findings
