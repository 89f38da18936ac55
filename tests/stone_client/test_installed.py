"""The installed `stone` as a user meets it, and the client without the platform."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import time
from importlib.util import find_spec
from pathlib import Path

import pytest

from stone_base.codes.catalogue import CATALOGUE
from stone_client.platform_part import PLATFORM_COMMANDS
from stone_local import registry
from testing.signals import hear_signals
from tests.stone_client.participating import refused, stone

STONE = Path(sys.executable).parent / "stone"
HEAVY = ("numpy", "scipy", "numba", "pyarrow", "open3d", "pydantic", "mcap", "rosbags")
SIMULATE = ("simulate", "run.mcap", "--truth", "truth", "--seconds", "600", "--channels", "16", "--columns", "180")


def run(*arguments: str, folder: Path | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run([STONE, *arguments], cwd=folder, check=False, capture_output=True, text=True, timeout=300)


def loaded_by(*arguments: str) -> list[str]:
    """The modules that are loaded once the command has run so."""
    program = (
        "import sys; from stone_client.main import main\ntry: main()\nfinally: print(*sys.modules, file=sys.stderr)"
    )
    command = [sys.executable, "-c", program, *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stderr.split()


@pytest.mark.parametrize("arguments", [("--help",), ("--version",), ("label", "--help"), ("inspect", "--help")])
def test_help_loads_nothing_heavy(arguments: tuple[str, ...]) -> None:
    loaded = {name.partition(".")[0] for name in loaded_by(*arguments)}
    of_typer = {"pydantic"} if len(arguments) > 1 else set[str]()  # with which it reads the types of options
    assert not loaded & {*HEAVY, "httpx", "services"} - of_typer


def test_a_command_loads_no_other() -> None:
    loaded = loaded_by("explain", "--help")
    assert [name for name in loaded if re.match(r"stone_\w+\.commands\.", name)] == ["stone_client.commands.explain"]


@pytest.mark.whole
def test_what_inspects_a_recording_loads_nothing_of_scipy_but_its_name() -> None:
    program = "import sys, services.ingest.sandboxed_inspection; print('scipy.sparse' in sys.modules)"
    outcome = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert outcome.stdout == "False\n", "a third of a second of each `stone inspect`"


def test_exit_codes_reach_the_shell(tmp_path: Path) -> None:
    (tmp_path / "page.zip").write_text("<html>")
    (tmp_path / "manifest.json").write_text(json.dumps({"stone_manifest": 1, "sequences": {"a": ["0" * 32]}}))
    refused = run("validate", "page.zip", "--manifest", "manifest.json", "--json", folder=tmp_path)
    assert refused.returncode == 1
    assert json.loads(refused.stdout)["ok"] is False
    assert "Traceback" not in refused.stderr
    assert run("validate", "absent.zip", "--manifest", "manifest.json", folder=tmp_path).returncode == 2
    assert run("--help").returncode == 0


def test_a_reader_that_leaves_early_is_no_fault(tmp_path: Path) -> None:
    outcome = subprocess.run(f"{STONE} --help | head -c 1", shell=True, check=True, capture_output=True, text=True)
    assert "Traceback" not in outcome.stderr


@pytest.mark.release
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupted_command_says_so_and_leaves_nothing_half_written(tmp_path: Path, number: int, code: int) -> None:
    """Catches alone what a signal leaves of a file that a real process writes."""
    process = subprocess.Popen(
        [STONE, *SIMULATE], cwd=tmp_path, stderr=subprocess.PIPE, text=True, preexec_fn=hear_signals
    )
    try:
        wait_for_staging(tmp_path, "run.mcap")
        process.send_signal(number)
        _, said = process.communicate(timeout=300)
    finally:
        process.kill()
    assert process.returncode == code
    assert "Traceback" not in said
    assert not (tmp_path / "run.mcap").exists()
    assert [name for name in os.listdir(tmp_path) if name.endswith(".partial")] == []


def wait_for_staging(folder: Path, name: str) -> None:
    until = time.monotonic() + 300
    while not any(folder.glob(f".{name}.*.partial")):
        assert time.monotonic() < until, "the command never began to write"
        time.sleep(0.05)


SOURCES = Path(__file__).resolve().parents[2]
PACKAGES = ("stone_base", "stone_files", "stone_submissions", "stone_client")
ALONE = "import sys; sys.path[:0] = sys.argv[1:3]; del sys.argv[1:3]; from stone_client.main import main; main()"


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of the client's packages and no others."""
    folder = tmp_path_factory.mktemp("client")
    for package in PACKAGES:
        shutil.copytree(SOURCES / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


def alone_stone(alone: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """The command where only those packages and those of others can be imported."""
    command = [sys.executable, "-I", "-S", "-c", ALONE, str(alone), sysconfig.get_path("purelib"), *arguments]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=300, cwd=alone)


def test_the_names_that_are_refused_are_those_of_the_platforms_commands() -> None:
    assert sorted(PLATFORM_COMMANDS) == sorted(place.word for place in registry.COMMANDS)


def test_help_lists_the_clients_own_commands_and_none_of_the_platform(alone: Path) -> None:
    said = alone_stone(alone, "--help")
    assert said.returncode == 0, said.stderr
    listed = {line.split()[1] for line in said.stdout.splitlines() if line.startswith("│ ") and line[2].isalpha()}
    assert listed >= {"auth", "sequence", "label-set", "dataset", "benchmark", "team", "validate", "explain"}
    assert not listed & set(PLATFORM_COMMANDS)


def test_a_command_of_the_platform_says_what_to_install(alone: Path) -> None:
    said = alone_stone(alone, "calibration", "check")
    assert said.returncode == 1
    assert said.stderr.startswith("platform_not_installed: `stone calibration` requires the platform")
    assert "`make install`, then `.venv/bin/stone calibration`" in said.stderr
    assert "stone-platform" not in said.stderr, "no index has that distribution, and anybody could put one there"


def test_validation_needs_nothing_of_the_platform(alone: Path, tmp_path: Path) -> None:
    (tmp_path / "page.zip").write_text("<html>")
    (tmp_path / "m.json").write_text(json.dumps({"stone_manifest": 1, "sequences": {"a": ["0" * 32]}}))
    said = alone_stone(alone, "validate", str(tmp_path / "page.zip"), "--manifest", str(tmp_path / "m.json"))
    assert said.returncode == 1
    assert said.stderr.splitlines()[0].startswith("not_zip: "), said.stderr


def test_a_code_is_explained_in_whatever_letters_it_is_typed() -> None:
    one = CATALOGUE["LAB-603"]
    for typed in ("LAB-603", "lab-603"):
        result = stone("explain", typed)
        assert result.exit_code == 0
        for words in ("LAB-603: labels may be wrong", one.meaning, one.remedy):
            assert words in result.stdout
    assert "no attempt is left" in stone("explain", "worker_lost").stdout


def test_an_unknown_code_is_refused() -> None:
    result = stone("explain", "XYZ-999")
    assert result.exit_code == 1
    assert result.stderr.startswith("unknown_code: 'XYZ-999'")


def test_the_client_alone_explains(alone: Path) -> None:
    said = alone_stone(alone, "explain", "TIM-201")
    assert said.returncode == 0, said.stderr
    assert said.stdout.startswith("TIM-201: labels unaffected")


@pytest.mark.skipif(find_spec("torch") is not None, reason="torch is installed here")
def test_training_without_torch_is_refused_in_one_line(tmp_path: Path) -> None:
    result = stone("model", "train", "l-openocc", tmp_path, "-o", tmp_path / "run")
    assert refused(result) == "no_torch"
    (line,) = result.stderr.splitlines()
    assert line == (
        "no_torch: torch is not installed; run `make baselines`, then .venv-baselines/bin/stone with the same arguments"
    )
    assert not (tmp_path / "run").exists()
