"""The columns of the held-out track, of a short simulated drive."""

from pathlib import Path

import pytest

from benchmarks.real.held_out import held_out_figures
from benchmarks.real.labelled_map import Figures
from services.ingest.sequence import open_sequence
from services.labeler.local_run import LabelOptions, label
from services.labeler.parameters import parameters_for
from simulator.options import SimulateOptions
from simulator.pipeline import simulate

DRIVE = SimulateOptions(6.0, 3, channels=32, columns=360, camera_width_px=96, world_width_m=60.0, speed_m_s=2.5)


@pytest.mark.whole
def test_the_columns_of_halves_are_the_figures_of_the_report(tmp_path: Path) -> None:
    simulate(tmp_path / "drive.mcap", DRIVE)
    sequence, sweeps = open_sequence(tmp_path / "drive.mcap", tmp_path / "drive.calibration.yaml", "drive")
    found = Figures()
    options = LabelOptions(parameters_for("field"), at_end=lambda run: found.update(held_out_figures(run)))
    report = label(sequence, sweeps, tmp_path / "labels", options)
    assert list(found) == ["first_0.35", "last_0.35", "first_0.5", "last_0.5", "first_0.7", "last_0.7"]
    for side, half in (("first", "from_first_half"), ("last", "from_second_half")):
        assert report.held_out[half] is not None
        assert found[f"{side}_0.5"] == pytest.approx(report.held_out[half]["recall"], abs=5e-5)
    assert found["first_0.35"] != found["first_0.5"]
