"""`stone recover` on a recording whose recorder died."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from stone_client.main import app


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.fixture(scope="module")
def cut(tmp_path_factory: pytest.TempPathFactory) -> Path:
    bag = tmp_path_factory.mktemp("recording") / "run.mcap"
    simulate(bag, SimulateOptions(seconds=1.0, channels=16, columns=180, cameras=False))
    bag.write_bytes(bag.read_bytes()[: bag.stat().st_size * 4 // 5])
    return bag


def test_a_cut_recording_is_refused_recovered_and_then_inspected(cut: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "recovered.mcap"
    refused = run("inspect", cut)
    assert refused.exit_code == 1
    assert "BAG-010" in refused.stderr
    assert "stone recover run.mcap -o recovered.mcap" in refused.stderr
    recovered = run("recover", cut, "-o", out)
    assert recovered.exit_code == 0
    assert recovered.stdout.strip() == str(out)
    assert recovered.stderr.startswith("warning: BAG-010: run.mcap was cut off at byte ")
    inspected = json.loads(run("inspect", out, "--json").stdout)
    assert sum(topic["count"] for topic in inspected["topics"]) > 50
    assert "BAG-011" not in [finding["code"] for finding in inspected["findings"]]


def test_json_says_what_was_kept_and_what_is_lost(cut: Path, tmp_path: Path) -> None:
    record = json.loads(run("recover", cut, "-o", tmp_path / "out.mcap", "--json").stdout)
    assert record["messages"] == sum(record["topics"].values()) > 50
    assert record["read_bytes"] < record["total_bytes"] == cut.stat().st_size
    assert record["lost"].startswith("Lost: ")
    assert record["finding"]["code"] == "BAG-010"


def test_the_recording_itself_is_never_written_over(cut: Path) -> None:
    before = cut.read_bytes()
    result = run("recover", cut, "-o", cut)
    assert result.exit_code == 1
    assert result.stderr.startswith("BAG-026: run.mcap is the original")
    assert cut.read_bytes() == before
