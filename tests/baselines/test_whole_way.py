"""The whole way of a model: `stone model train`, `stone model predict --submit` to a real server, a row of its board.

Catches alone commands, exports and server that no longer fit together.
"""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from structlog.testing import capture_logs

from stone_submissions.manifest import read_manifest
from testing.worlds.small_export import SmallExport, write_small_export
from tests.baselines.small_training import logged_steps, row_record
from tests.stone_client.participating import Served, answered, joined, scoring, serving_world, stone

pytestmark = pytest.mark.whole


@pytest.fixture
def served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    """A benchmark of two hidden-free sequences of two frames, and who submits to it."""
    with serving_world(tmp_path / "server", frames=2) as (world, url), capture_logs():
        made = joined(world, url)
        monkeypatch.setenv("STONE_CONFIG_HOME", str(tmp_path / "configuration"))
        monkeypatch.setenv("STONE_URL", url)
        monkeypatch.setenv("STONE_TOKEN", made.captain.secret)
        yield made


def test_a_trained_row_reaches_the_board(served: Served, meadow: Path, tmp_path: Path) -> None:
    torch.set_num_threads(1)
    (tmp_path / "row.yaml").write_text(json.dumps(row_record()))
    run, manifest = tmp_path / "run", tmp_path / "M.json"
    trained = answered("model", "train", tmp_path / "row.yaml", meadow, "-o", run, "--epochs", "1", "--watch", meadow)
    assert (trained["steps"], trained["frames"]) == (4, 9)
    again = stone(
        "model", "train", tmp_path / "row.yaml", meadow, "-o", run, "--epochs", "1", "--watch", meadow, "--resume"
    )
    assert again.exit_code == 0, again.stderr
    assert logged_steps(run) == [1, 2, 3, 4]

    stone("benchmark", "manifest", served.world.benchmark, "val", "-o", manifest)
    exports = [
        write_small_export(tmp_path / name, SmallExport(name, len(tokens), is_labelled=False, named=tokens))
        for name, tokens in read_manifest(manifest).sequences.items()
    ]
    said = ("--manifest", manifest, "-o", tmp_path / "sub.zip", "--submit", *served.at("val"), "--team", served.team)
    with scoring(served.platform):
        sent = answered("model", "predict", run, *exports, *said)
    assert sent["state"] == "scored"
    board = answered("benchmark", "leaderboard", served.world.benchmark, "val")
    (entry,) = [row for row in board["rows"] if row["team"] == served.team]
    assert (entry["method"], entry["modality"]) == ("Small", "L")


@pytest.mark.parametrize(
    ("options", "code"),
    [(("--resume",), "bad_run"), (("--batch", "10"), "too_few_frames"), (("--backbone", "BACKBONE"), "bad_run")],
)
def test_refusals_are_one_line(meadow: Path, tmp_path: Path, options: tuple[str, ...], code: str) -> None:
    (tmp_path / "row.yaml").write_text(json.dumps(row_record()))
    (tmp_path / "weights.pth").write_bytes(b"")
    said = [str(tmp_path / "weights.pth") if word == "BACKBONE" else word for word in options]
    result = stone("model", "train", tmp_path / "row.yaml", meadow, "-o", tmp_path / "run", *said)
    assert result.exit_code == 1, result.exception
    assert result.stderr.splitlines()[-1].startswith(f"{code}: ")
