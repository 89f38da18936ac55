"""The installation says what it does and where its log is, and comes through without uv."""

import ast
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DEPLOY = ROOT / "deploy"
TOOLS = ("mkdir", "date", "tail", "sed", "grep", "head", "touch", "rm", "cat")
OF_LARGER_RUNS = {"moments.move_rows", "observed_voxels._rehash"}  # where a table or a map grows
INDEX = "-".join(("index", "url"))  # pip's word, which no file of ours may set: tests/test_architecture.py
WHEEL_HASH = re.compile(r"--hash=sha256:[0-9a-f]{64}")


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


def test_a_step_says_that_it_begins_and_ends_and_keeps_the_rest_in_its_log(project: Path) -> None:
    program(project / "fetch.sh", "echo a hundred lines; echo warning >&2")
    outcome = run(project, "deploy/step.sh", "1/2", "fetch", "packages", "./fetch.sh")
    begins, ends = outcome.stdout.splitlines()
    assert begins == "[1/2] packages (log: build/install/fetch.log)"
    assert re.fullmatch(r"\[1/2\] packages: done in \d+ s", ends)
    assert (outcome.returncode, outcome.stderr) == (0, "")
    assert (project / "build" / "install" / "fetch.log").read_text() == "a hundred lines\nwarning\n"


def test_a_step_that_fails_shows_the_end_of_its_log_and_where_it_is(project: Path) -> None:
    program(project / "fetch.sh", "i=0; while [ $i -lt 99 ]; do i=$((i + 1)); echo line $i; done; exit 3")
    outcome = run(project, "deploy/step.sh", "1/2", "fetch", "packages", "./fetch.sh")
    assert outcome.returncode == 3
    assert "failed with exit code 3. The end of build/install/fetch.log:" in outcome.stderr
    assert "    line 99\n" in outcome.stderr
    assert "line 1\n" not in outcome.stderr


def test_packages_come_by_uv_where_it_is_on_path(project: Path) -> None:
    program(project / "bin" / "uv", 'echo "uv $*"')
    outcome = run(project, "deploy/add-packages.sh", "-r", "some.lock")
    assert outcome.stdout == "uv pip install --python .venv/bin/python -r some.lock\n"


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


def test_where_pip_is_told_what_uv_cannot_be_it_is_pip_s_work(project: Path) -> None:
    fetched_uv(project, "global.find-links='wheels'\nglobal.no-index='true'")
    outcome = run(project, "deploy/uv.sh", "venv")
    assert (outcome.returncode, outcome.stdout) == (127, "")


def test_uv_is_fetched_by_its_hash_and_as_a_wheel() -> None:
    lock = (DEPLOY / "uv.lock").read_text("utf-8")
    assert re.findall(r"(?m)^(\S+?)==", lock) == ["uv"]
    assert WHEEL_HASH.search(lock)
    assert "--only-binary :all: --require-hashes -r deploy/uv.lock" in (DEPLOY / "uv.sh").read_text("utf-8")


def test_a_python_that_is_too_old_or_absent_is_passed_over(project: Path) -> None:
    program(project / "bin" / "old", "exit 1")
    program(project / "bin" / "fit", "exit 0")
    assert run(project, "deploy/find-python.sh", "none", "old", "fit").stdout == "fit\n"
    outcome = run(project, "deploy/find-python.sh", "none", "old")
    assert (outcome.returncode, outcome.stdout) == (1, "")
    assert "Python 3.11 or 3.12 is needed" in outcome.stderr


@pytest.mark.parametrize("script", sorted(DEPLOY.glob("*.sh")), ids=lambda path: path.name)
def test_every_script_is_one(script: Path) -> None:
    outcome = subprocess.run(["sh", "-n", script], check=False, capture_output=True, text=True)
    assert (outcome.returncode, outcome.stderr) == (0, "")
    assert os.access(script, os.X_OK)


def product_kernels() -> set[str]:
    """The functions that numba keeps compiled, by module and name."""
    found = set()
    for package in ("stone", "stone_recordings", "stone_local", "services", "simulator"):
        for path in (ROOT / package).rglob("*.py"):
            functions = (node for node in ast.parse(path.read_bytes()).body if isinstance(node, ast.FunctionDef))
            kept = [one.name for one in functions if any("cache=True" in ast.unparse(d) for d in one.decorator_list)]
            found |= {f"{path.stem}.{name}" for name in kept}
    return found


@pytest.mark.whole
def test_the_installation_leaves_every_kernel_compiled(tmp_path: Path) -> None:
    """Catches alone a kernel that the first labelled run of a new machine would have to wait for (a minute)."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, str(DEPLOY / "warm_kernels.py")]
    subprocess.run(command, cwd=ROOT, env=environment, check=True, capture_output=True, timeout=600)
    compiled = {path.name.partition("-")[0] for path in tmp_path.rglob("*.nbi")}
    assert len(compiled) > 60
    assert product_kernels() - compiled <= OF_LARGER_RUNS
