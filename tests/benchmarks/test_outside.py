"""The benchmark of the analytic worlds. Catches alone: a variant on kept surfaces that differs from a whole run."""

from pathlib import Path

import pytest

from benchmarks.outside.rows import Outcome, Row, kept, measure
from benchmarks.outside.table import show
from benchmarks.outside.variants import measure_variant
from services.labeler.parameters import parameters_for
from testing.outside.drive import OutsideDrive


def test_a_table_adds_worlds_and_names_the_worst_and_what_was_refused(capsys: pytest.CaptureFixture[str]) -> None:
    good = {"drivable kept": 90, "drivable lost": 10, "obstacle kept": 100, "danger of:rock": 10, "danger:rock": 0}
    bad = {"drivable kept": 100, "obstacle kept": 60, "obstacle lost": 40, "danger of:rock": 10, "danger:rock": 5}
    outcomes = [
        Outcome(1, good, ("LAB-606",)),
        Outcome(1, bad, ("LAB-606",)),
        Outcome(0, {}, (), "footprint_off_ground"),
    ]
    show({("64", "sound", "local"): outcomes})
    row = next(line for line in capsys.readouterr().out.splitlines() if "footprint_off_ground" in line)
    cells = [cell.strip() for cell in row.split("|")[1:-1]]
    assert cells[3:9] == ["0.792", "0.714", "20.0%", "40.0%", "5.0%", "10.0%"]
    assert cells[13:] == ["rock 50%", "0", "LAB-606×2", "footprint_off_ground×1"]


@pytest.mark.release
def test_a_variant_on_kept_surfaces_is_judged_as_a_whole_run_is(tmp_path: Path) -> None:
    row = Row(OutsideDrive("forest", 16, seconds=3.0, columns=400), "mount 10 cm low", "local")
    whole = measure(row, tmp_path)
    assert kept(row, tmp_path) == whole
    for _ in ("made", "kept"):
        assert measure_variant(row, tmp_path, parameters_for("local")).counts == whole.counts
