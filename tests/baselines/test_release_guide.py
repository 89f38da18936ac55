"""The page "Use the STONE release", line by line, on a small twin of the release; imports: tests/e2e/test_guides.py.

Catches alone a step between the ZIP and a scored row that the page promises and no command does.
"""

import sys
from pathlib import Path

import pytest

from stone_submissions.manifest import read_manifest
from testing.worlds.released_datasets import CAMERAS, ReleasedDataset, write_released_zip
from tests.e2e.pasting import blocks, shell_in, statements
from tests.stone_client.participating import answered

pytestmark = pytest.mark.whole

ROOT = Path(__file__).resolve().parents[2]
PAGE = "use-the-release.md"
SMALLER = {
    "[-25.6, -25.6, -1.0]": "[-12.8, -12.8, -1.0]",
    "[128, 128, 16]": "[64, 64, 16]",
    "--epochs 8": "--epochs 1",
}


def test_the_page_leads_from_the_zip_to_a_scored_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    twin = ReleasedDataset(scenes=4, frames=2, cameras=CAMERAS)
    write_released_zip(tmp_path / "STONE.zip", twin)
    (tmp_path / ".venv-baselines").symlink_to(Path(sys.executable).parents[1])
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    typed = [line for kind, block in blocks(PAGE) if not kind for line in statements(block)]
    with shell_in(tmp_path, SMALLER, monkeypatch) as shell:
        assert shell.paste(PAGE, {line for line in typed if " import " in line}) == 10
        geometry, trained = (
            answered("score", name, "--ground-truth", "val", "--mask", "lidar") for name in ("sweep.zip", "row.zip")
        )
    train, val = read_manifest(tmp_path / "train.json"), read_manifest(tmp_path / "val.json")
    assert [*train.sequences, *val.sequences] == list(twin.tables.names)
    assert len(val.sequences) == 2, "a drive"
    assert train.grid.name == val.grid.name == "release"
    for scores in (geometry, trained):
        assert "mask:lidar|grid:200x200x16@0.4m" in scores["signature"]
    assert geometry["total"]["iou_occ"] > 0.3
