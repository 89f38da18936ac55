"""`stone train` and `stone predict` where torch is not installed: one line says what to do."""

from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.stone_client.participating import refused, stone

pytestmark = pytest.mark.skipif(find_spec("torch") is not None, reason="torch is installed here")


def test_training_without_torch_is_refused_in_one_line(tmp_path: Path) -> None:
    result = stone("train", "l-openocc", tmp_path, "-o", tmp_path / "run")
    assert refused(result) == "no_torch"
    (line,) = result.stderr.splitlines()
    assert line == (
        "no_torch: torch is not installed here: run `make baselines`, then .venv-baselines/bin/stone with the same "
        "arguments (or pip install 'stone-platform[baselines]')"
    )
    assert not (tmp_path / "run").exists()


def test_predicting_without_torch_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "M.json").write_text("{}")
    result = stone("predict", tmp_path, tmp_path, "--manifest", tmp_path / "M.json", "-o", tmp_path / "sub.zip")
    assert refused(result) == "no_torch"
    assert len(result.stderr.splitlines()) == 1


@pytest.mark.parametrize("command", ["train", "predict"])
def test_what_they_take_is_told_without_torch(command: str) -> None:
    result = stone(command, "--help")
    assert result.exit_code == 0
    assert "Needs torch" in result.stdout
