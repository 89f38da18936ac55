"""The installed `stone`, as a user meets it: a process with streams, signals and an exit code."""

import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from testing.signals import hear_signals

ROOT = Path(__file__).resolve().parents[2]
STONE = Path(sys.executable).parent / "stone"
HEAVY = ("numpy", "scipy", "numba", "pyarrow", "open3d", "pydantic", "mcap", "rosbags")
SIMULATE = ("simulate", "run.mcap", "--truth", "truth", "--seconds", "600", "--channels", "16", "--columns", "180")


def run(*arguments: str, folder: Path | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run([STONE, *arguments], cwd=folder, check=False, capture_output=True, text=True, timeout=300)


def processor_s(*command: str | Path) -> float:
    """What a command takes of the processor."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def test_help_takes_little_more_than_the_library_of_commands_itself() -> None:
    """Measured beside it, in turns and the least of three each, since other work slows both down."""
    library = [sys.executable, "-c", "import typer, typer.rich_utils"]
    taken = [(processor_s(STONE, "--help"), processor_s(*library)) for _ in range(3)]
    ours, theirs = (min(each) for each in zip(*taken, strict=True))
    assert ours < 2 * theirs


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


def test_help_of_all_commands_loads_none_of_them() -> None:
    loaded = loaded_by("--help")
    assert "typer" in loaded
    assert [name for name in loaded if re.match(r"stone_\w+\.commands\.", name) and not is_package(name)] == []


def is_package(name: str) -> bool:
    return (ROOT / name.replace(".", "/")).is_dir()


def test_a_command_loads_no_other() -> None:
    loaded = loaded_by("explain", "--help")
    assert [name for name in loaded if re.match(r"stone_\w+\.commands\.", name)] == ["stone_client.commands.explain"]


def test_what_inspects_a_recording_loads_nothing_of_scipy_but_its_name() -> None:
    program = "import sys, services.ingest.outlook; print('scipy.sparse' in sys.modules)"
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


@pytest.mark.whole
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


def test_an_output_in_a_folder_that_may_not_be_written_is_refused(tmp_path: Path) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may write everywhere")
    tmp_path.chmod(0o500)
    refused = run("simulate", "run.mcap", "--seconds", "1", folder=tmp_path)
    assert refused.returncode == 1
    assert refused.stderr.splitlines()[-1].startswith("not_permitted: ")
