"""A small season on the embedded platform, and the script by which the board of any season is computed anew.

Catches alone a board that drifts from its kept counts over a whole season.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.season.__main__ import RECOMPUTE, run_season
from benchmarks.season.world import SeasonSize

SMALL = SeasonSize(teams=5, submissions=20, sequences=1, frames=2, scorings=3, seed=145)


@pytest.mark.whole
def test_a_season_ends_with_the_board_that_its_kept_counts_make(tmp_path: Path) -> None:
    figures = run_season(tmp_path, SMALL)
    assert figures.recomputed.endswith("equal to the board of all: True, of the best: True")
    assert figures.changed_past == 0
    assert figures.submissions == SMALL.submissions
    assert figures.states == {"scored": SMALL.submissions - 2, "invalid": 2}
    assert 0 < figures.grants <= SMALL.submissions - SMALL.teams * SMALL.scorings
    assert figures.alarms["equal_content"] >= 1
    assert [move["new"]["truth_number"] for move in figures.moves] == [2, 2, 3]
    assert [move["new"]["metric"] for move in figures.moves] == ["stone-iou-2"] + ["stone-iou-occupied-2"] * 2
    assert all(move["rescore"]["missing"] == 0 and move["largest_value_move"] > 0 for move in figures.moves)


def _row(submission_id: str, rank: int, ratios: dict[str, float], team: str) -> dict[str, Any]:
    return {
        "standing": "ranked",
        "rank": rank,
        "submission_id": submission_id,
        "team": team,
        "ratios": ratios,
        "submitted_at": f"2026-05-03T09:12:{rank:02d}Z",
    }


def _counts(folder: Path, name: str, right: int) -> dict[str, float]:
    """Kept counts in which each class is right `right` times and taken for free once; their ratios by hand."""
    counts = np.zeros((2, 3, 4, 4), np.int32)
    counts[0, 0] = np.diag([100, right, right, right])
    counts[1, 2, 1:, 0] = 1
    np.savez(folder / f"{name}.npz", confusions=counts)
    iou = right / (right + 1)
    return {"iou_occ": 3 * right / (3 * right + 3), **dict.fromkeys(("iou_t", "iou_p", "iou_n", "miou"), iou)}


def _recomputed(folder: Path, rows: list[dict[str, Any]], best: list[dict[str, Any]]) -> int:
    pair = {"metric": "stone-iou-2"}
    boards = {"all": {"pair": pair, "rows": rows}, "best": {"pair": pair, "rows": best}}
    (folder / "boards.json").write_text(json.dumps(boards))
    return subprocess.run([sys.executable, RECOMPUTE, folder], check=False, capture_output=True).returncode


def test_the_script_accepts_the_true_board_and_no_other(tmp_path: Path) -> None:
    first, second = _counts(tmp_path, "a", 3), _counts(tmp_path, "b", 1)
    rows = [_row("a", 1, first, "Alpha"), _row("b", 2, second, "Alpha")]
    assert _recomputed(tmp_path, rows, rows[:1]) == 0
    for wrong, best in (
        ([_row("b", 1, second, "Alpha"), _row("a", 2, first, "Alpha")], rows[:1]),
        ([_row("a", 1, first, "Alpha"), _row("b", 1, second, "Alpha")], rows[:1]),
        ([_row("a", 1, {**first, "iou_t": np.nextafter(0.75, 1)}, "Alpha"), rows[1]], rows[:1]),
        (rows, rows),
        (rows, [_row("b", 1, second, "Alpha")]),
    ):
        assert _recomputed(tmp_path, wrong, best) == 1
