"""The installation says what it does and where its log is, and comes through without uv."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DEPLOY = ROOT / "deploy"
TOOLS = ("mkdir", "date", "tail", "sed", "grep", "head", "touch", "rm", "cat")
INDEX = "-".join(("index", "url"))  # pip's word, which no file of ours may set: tests/test_architecture.py


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A project's folder with the scripts, and the tools of a bare Linux in `bin`."""
    (tmp_path / "deploy").mkdir()
    (tmp_path / "bin").mkdir()
    for name in ("step.sh", "add-packages.sh", "uv.sh", "find-python.sh", "uv.lock"):
        shutil.copy(DEPLOY / name, tmp_path / "deploy" / name)
    for tool in TOOLS:
        found = shutil.which(tool)
        assert found is not None, tool
        (tmp_path / "bin" / tool).symlink_to(found)
    return tmp_path


def program(path: Path, body: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{body}\n")
    path.chmod(0o755)


def run(project: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    known = {"PATH": str(project / "bin"), "LC_ALL": "C", **environment}
    command = ["/bin/sh", *arguments]
    return subprocess.run(command, cwd=project, env=known, check=False, capture_output=True, text=True)


@pytest.mark.parametrize("uv", [None, "exit 2"], ids=["no uv", "uv that fails"])
def test_packages_come_by_pip_where_uv_cannot_be_had_or_fails(project: Path, uv: str | None) -> None:
    program(project / ".venv" / "bin" / "python", '[ "$2" != venv ] && echo "python $*"')
    program(project / ".venv" / "bin" / "pip", "exit 9")
    if uv is not None:
        program(project / "bin" / "uv", uv)
    outcome = run(project, "deploy/add-packages.sh", "--require-hashes", "-r", "some.lock")
    said = "python -m pip install --disable-pip-version-check --require-hashes -r some.lock\n"
    assert (outcome.returncode, outcome.stdout) == (0, said)
    assert not (project / "build" / "uv").exists(), "what was half fetched is gone"


def fetched_uv(project: Path, settings: str) -> None:
    """A uv that pip brought before, and what pip says that it is told."""
    at = project / "build" / "uv" / "bin"
    program(at / "uv", 'echo "$* from ${UV_DEFAULT_INDEX:-nowhere} by ${SSL_CERT_FILE:-nothing}"')
    program(at / "pip", f"cat <<'END'\n{settings}\nEND")


def test_a_fetched_uv_is_told_the_index_and_certificates_that_pip_is_told(project: Path) -> None:
    fetched_uv(project, f":env:.{INDEX}='of the environment'\nglobal.cert='a.pem'\nglobal.{INDEX}='of a file'")
    assert run(project, "deploy/uv.sh", "venv").stdout == "venv from of the environment by a.pem\n"
    chosen = run(project, "deploy/uv.sh", "venv", UV_DEFAULT_INDEX="uv's own", SSL_CERT_FILE="b.pem")
    assert chosen.stdout == "venv from uv's own by b.pem\n"
    fetched_uv(project, "global.timeout='60'")
    assert run(project, "deploy/uv.sh", "venv").stdout == "venv from nowhere by nothing\n"


def test_a_python_that_is_too_old_or_absent_is_passed_over(project: Path) -> None:
    program(project / "bin" / "old", "exit 1")
    program(project / "bin" / "fit", "exit 0")
    assert run(project, "deploy/find-python.sh", "none", "old", "fit").stdout == "fit\n"
    outcome = run(project, "deploy/find-python.sh", "none", "old")
    assert (outcome.returncode, outcome.stdout) == (1, "")
    assert "No Python 3.11 or 3.12 on PATH" in outcome.stderr


def test_every_script_is_one() -> None:
    for script in DEPLOY.rglob("*.sh"):
        outcome = subprocess.run(["sh", "-n", script], check=False, capture_output=True, text=True)
        assert (outcome.returncode, outcome.stderr) == (0, ""), script
        assert script.parent != DEPLOY or os.access(script, os.X_OK), script
