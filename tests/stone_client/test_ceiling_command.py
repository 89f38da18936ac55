"""`stone ceiling`: the halves of a drive are disjoint and make the whole, and the score is that of their labels."""

from pathlib import Path

import numpy as np
import pytest

from services.ingest.sequence import open_sequence
from simulator.pipeline import calibration_path
from stone_client.server.published_tables import table_named
from stone_client.tables import score_table
from stone_recordings.sync.halved_sweeps import HalvedSweeps
from testing.refusals import refused_as
from tests.plain_confusion import confusion_matrix
from tests.stone_client.participating import answered, stone


def test_both_halves_of_the_sweeps_are_the_sweeps(bag: Path) -> None:
    sequence, sweeps = open_sequence(bag, calibration_path(bag), "run")
    halves = [HalvedSweeps(sweeps, "sweeps", half) for half in (0, 1)]
    for index in range(len(sequence.frames)):
        present, absent = halves[index % 2].sweep(index), halves[1 - index % 2].sweep(index)
        np.testing.assert_array_equal(present.points_lidar, sweeps.sweep(index).points_lidar)
        assert (absent.points_lidar.shape, absent.stamp_ns) == ((0, 3), present.stamp_ns)


def test_both_halves_of_the_rings_are_every_point_and_never_share_an_elevation(bag: Path) -> None:
    _, sweeps = open_sequence(bag, calibration_path(bag), "run")
    even, odd = (HalvedSweeps(sweeps, "rings", half).sweep(3).points_lidar for half in (0, 1))
    whole = sweeps.sweep(3).points_lidar
    assert sorted(map(tuple, np.concatenate([even, odd]).tolist())) == sorted(map(tuple, whole.tolist()))
    assert 0.3 < len(even) / len(whole) < 0.7


def test_points_without_rings_are_not_halved_by_them(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _, sweeps = open_sequence(bag, calibration_path(bag), "run")
    monkeypatch.setattr("stone_recordings.messages.lidar.RING_NAMES", ())
    with refused_as("no_rings"):
        HalvedSweeps(sweeps, "rings", 0).sweep(0)


def test_the_score_is_that_of_one_half_against_the_other(bag: Path, tmp_path: Path) -> None:
    record = answered("ceiling", bag, "--calibration", calibration_path(bag), "-o", tmp_path, "--by", "rings")
    grids = [
        {path.parent.name: np.load(path)["semantics"] for path in (tmp_path / half).glob("gts/*/*/labels.npz")}
        for half in ("even", "odd")
    ]
    assert len(grids[0]) == record["frames"] > 1
    everywhere = np.ones((256, 256, 32), np.bool_)
    expected = sum(confusion_matrix(grid, grids[1][token], everywhere) for token, grid in grids[0].items())
    assert record["confusion"] == np.asarray(expected).tolist()
    (row,) = table_named(str(tmp_path / "ceiling.json")).reported()
    shown = None if record["total"]["iou_occ"] is None else round(record["total"]["iou_occ"], 3)
    assert (row["iou_occ"], row["modality"], row["kind"]) == (shown, "L", "ceiling")
    assert "even rings" in row["note"]
    assert score_table(record, "").row_count == 7


def test_a_file_that_is_no_ceiling_is_refused(tmp_path: Path) -> None:
    for content in ("{}", "[]", '{"title": "", "source": "", "note": "", "rows": [{"method": 1}]}', "\x00"):
        (tmp_path / "ceiling.json").write_text(content)
        with refused_as("no_such_table"):
            table_named(str(tmp_path / "ceiling.json"))
    assert (
        stone(
            "benchmark", "reported", "table9", "--benchmark", "b", "--phase", "p", "--server", "http://localhost:1"
        ).exit_code
        != 0
    )
