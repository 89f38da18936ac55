"""The client without the platform: its own commands work, the platform's say what to install."""

import json
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from stone_client.platform_part import PLATFORM_COMMANDS
from stone_client.release import own_release
from stone_local import registry

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("stone_base", "stone_files", "stone_submissions", "stone_client")
ALONE = "import sys; sys.path[:0] = sys.argv[1:3]; del sys.argv[1:3]; from stone_client.main import main; main()"


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of the client's packages and no others."""
    folder = tmp_path_factory.mktemp("client")
    for package in PACKAGES:
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


def stone(alone: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """The command where only those packages and those of others can be imported."""
    command = [sys.executable, "-I", "-S", "-c", ALONE, str(alone), sysconfig.get_path("purelib"), *arguments]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=300, cwd=alone)


def test_the_names_that_are_refused_are_those_of_the_platforms_commands() -> None:
    assert sorted(PLATFORM_COMMANDS) == sorted(place.word for place in (*registry.COMMANDS, *registry.GROUPS))


def test_help_lists_the_clients_own_commands_and_none_of_the_platform(alone: Path) -> None:
    said = stone(alone, "--help")
    assert said.returncode == 0, said.stderr
    listed = {line.split()[1] for line in said.stdout.splitlines() if line.startswith("│ ") and line[2].isalpha()}
    assert listed >= {"login", "benchmarks", "manifest", "inputs", "datasets", "validate", "submit", "results", "teams"}
    assert listed >= {"leaderboard", "compare", "upload", "process", "status", "watch", "download"}
    assert not listed & set(PLATFORM_COMMANDS)


@pytest.mark.parametrize("words", [("label", "a.mcap", "-o", "out"), ("serve", "--help"), ("calibration", "check")])
def test_a_command_of_the_platform_says_what_to_install(alone: Path, words: tuple[str, ...]) -> None:
    said = stone(alone, *words)
    assert said.returncode == 1
    assert said.stderr.startswith(f"platform_not_installed: `stone {words[0]}` needs the platform")
    assert "stone-platform" in said.stderr


def test_the_sdk_refuses_what_only_the_platform_can(alone: Path) -> None:
    program = (
        "import sys; sys.path[:0] = sys.argv[1:3]\n"
        "from stone_client.sdk import Stone\n"
        "from stone_client.errors import PlatformNotInstalledError\n"
        "try: Stone('http://127.0.0.1:1', 'token').baseline([], 'm.json', 'out.zip')\n"
        "except PlatformNotInstalledError as error: print(error.code)\n"
    )
    command = [sys.executable, "-I", "-S", "-c", program, str(alone), sysconfig.get_path("purelib")]
    said = subprocess.run(command, check=True, capture_output=True, text=True, cwd=alone)
    assert said.stdout == "platform_not_installed\n"


def test_validation_needs_nothing_of_the_platform(alone: Path, tmp_path: Path) -> None:
    (tmp_path / "page.zip").write_text("<html>")
    (tmp_path / "m.json").write_text(json.dumps({"stone_manifest": 1, "sequences": {"a": ["0" * 32]}}))
    said = stone(alone, "validate", str(tmp_path / "page.zip"), "--manifest", str(tmp_path / "m.json"))
    assert said.returncode == 1
    assert said.stderr.splitlines()[0].startswith("not_zip: "), said.stderr


def test_the_release_is_said(alone: Path) -> None:
    assert stone(alone, "--version").stdout == f"stone {own_release()}\n"
