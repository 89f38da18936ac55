"""Rounds with real processes, as `python -m chaos.scoring` plays them."""

import re
import sys
from pathlib import Path

import pytest

from chaos import scoring


@pytest.mark.whole
def test_no_kill_costs_a_score_or_a_scoring(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches alone a score that a `kill -9` of a real worker loses, doubles or changes."""
    monkeypatch.setattr(sys, "argv", ["scoring", "--rounds", "3", "--seed", "3", "--folder", str(tmp_path / "place")])
    code = scoring.main()
    said = capsys.readouterr().out
    assert code == 0, said
    assert re.search(r"\d rounds, 3 hit work", said), said  # a round that hits nothing is played again
    assert "lost 0, doubled 0, differing 0" in said
