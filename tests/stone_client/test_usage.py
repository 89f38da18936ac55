"""What is asked wrongly is a usage error, exit code 2, before any work."""

from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from stone_client.main import app

LOCAL = ["simulate", "inspect", "label", "export", "baseline", "validate", "score", "demo", "calibration"]
ON_A_SERVER = [
    "serve",
    "login",
    "upload",
    "import",
    "process",
    "watch",
    "status",
    "exports",
    "notifications",
    "download",
    "statistics",
    "splits",
    "datasets",
    "benchmarks",
    "teams",
    "manifest",
    "inputs",
    "submit",
    "results",
    "leaderboard",
    "compare",
    "withdraw",
    "reported",
]
COMMANDS = [*LOCAL, *ON_A_SERVER]


def stone(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_help_names_every_command_that_exists() -> None:
    result = stone("--help")
    assert result.exit_code == 0
    for command in COMMANDS:
        assert command in result.stdout


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command: str) -> None:
    result = stone(command, "--help")
    assert result.exit_code == 0
    assert "--help" in result.stdout


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["inspect"],
        ["inspect", "absent.mcap"],
        ["label", "absent.mcap", "--calibration", "absent.yaml", "-o", "out"],
        ["validate", "absent.zip", "--manifest", "absent.json"],
        ["score", "absent.zip", "--ground-truth", "absent"],
        ["simulate", "out.mcap", "--seconds", "0"],
        ["simulate", "out.mcap", "--seconds", "nan"],
        ["simulate", "out.mcap", "--channels", "100000"],
        ["simulate", "out.mcap", "--seed", "-1"],
        ["demo", "--workers", "0"],
        ["inspect", "absent.mcap", "--unknown"],
        ["upload", "absent.mcap", "--calibration", "absent.yaml"],
        ["process"],
        ["watch"],
        ["download", "run"],
        ["download", "run", "--format", "nuscenes", "-o", "folder"],
        ["download", "run", "--format", "obj", "-o", "run.tar"],
        ["exports"],
        ["exports", "run", "--format", "obj"],
        ["serve", "--port", "65536"],
        ["serve", "--workers", "0"],
    ],
    ids=" ".join,
)
def test_wrong_usage_is_exit_code_2(arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert stone(*arguments).exit_code == 2
    assert list(tmp_path.iterdir()) == []


def test_a_missing_calibration_is_usage(tmp_path: Path) -> None:
    bag = tmp_path / "run.mcap"
    bag.write_bytes(b"")
    result = stone("label", bag, "--calibration", tmp_path / "absent.yaml", "-o", tmp_path / "out")
    assert result.exit_code == 2
    assert "does not exist" in result.stderr


def test_an_unknown_profile_is_usage(tmp_path: Path) -> None:
    for name in ("run.mcap", "rig.yaml"):
        (tmp_path / name).write_bytes(b"")
    inputs = (tmp_path / "run.mcap", "--calibration", tmp_path / "rig.yaml", "-o", tmp_path / "out")
    assert stone("label", *inputs, "--profile", "global").exit_code == 2
