"""Missing system libraries are installed where that is allowed; else the exact line to run is said."""

import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "deploy" / "install-system-libraries.sh"
APT_LINE = "apt-get update && apt-get install -y --no-install-recommends libusb-1.0-0 libegl1"


def program(folder: Path, name: str, body: str) -> Path:
    path = folder / name
    path.write_text(f"#!/bin/sh\n{body}\n")
    path.chmod(0o755)
    return path


def run_as(user: str, folder: Path, python: Path) -> subprocess.CompletedProcess[str]:
    """The script on a machine where this Python misses libraries until apt-get has installed them."""
    program(folder, "id", f"echo {0 if user == 'root' else 1000}")
    program(folder, "sudo", 'if [ "$2" = true ]; then exit 0; fi\nshift\nexec "$@"' if user == "sudoer" else "exit 1")
    environment = {"PATH": f"{folder}:/bin", "LC_ALL": "C"}
    return subprocess.run([str(SCRIPT), str(python)], env=environment, check=False, capture_output=True, text=True)


@pytest.fixture
def python(tmp_path: Path) -> Path:
    installed = tmp_path / "apt.log"
    program(tmp_path, "apt-get", f'echo "apt-get $*" >> {installed}')
    return program(tmp_path, "python", f"grep -q install {installed} 2>/dev/null || echo libusb-1.0-0 libegl1")


@pytest.mark.parametrize("user", ["root", "sudoer"])
def test_who_may_install_gets_them_installed(tmp_path: Path, python: Path, user: str) -> None:
    outcome = run_as(user, tmp_path, python)
    assert outcome.returncode == 0, outcome.stderr
    update, install = (tmp_path / "apt.log").read_text().splitlines()
    assert update == "apt-get update -qq"
    assert install == "apt-get install -y -qq --no-install-recommends libusb-1.0-0 libegl1"


def test_who_may_not_install_is_told_the_line(tmp_path: Path, python: Path) -> None:
    outcome = run_as("nobody", tmp_path, python)
    assert outcome.returncode == 1
    assert f"    sudo sh -c '{APT_LINE}'\n" in outcome.stderr
    assert not (tmp_path / "apt.log").exists()
