"""The client's wheel in an empty environment: small, with few packages, and all that a participant needs.

Catches alone a module or a distribution that the client needs and its wheel does not bring.
"""

import json
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest

from stone_base.releases import HEADER
from stone_client.release import own_release
from testing.stone_serve import environment
from testing.stone_serve import serving as serving_process
from tests.deploy.wheels import built_wheel
from tests.stone_client.participating import Served, joined, scoring, serving_world, zipped

pytestmark = pytest.mark.whole

ROOT = Path(__file__).resolve().parents[3]
MOST_BYTES = 2_000_000
MOST_PACKAGES = 25
BARRED = {"open3d", "open3d-cpu", "numba", "scipy", "sqlalchemy", "celery", "fastapi", "stone-platform"}
UNREACHABLE = ("No matching distribution", "Could not find a version", "Connection")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built_wheel(ROOT / "deploy" / "client", tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def empty(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment that held nothing, and the wheel installed into it as the page says to."""
    return installed(wheel, sys.executable, tmp_path_factory.mktemp("empty") / "venv")


def installed(wheel: Path, python: str | Path, folder: Path) -> Path:
    """An environment of this Python that holds the wheel and what comes along."""
    subprocess.run([str(python), "-m", "venv", str(folder)], check=True)
    installing = [folder / "bin" / "pip", "install", "--quiet", "--disable-pip-version-check", str(wheel)]
    outcome = subprocess.run(installing, check=False, capture_output=True, text=True, timeout=600)
    if outcome.returncode and any(words in outcome.stderr for words in UNREACHABLE):
        pytest.skip("no index of packages can be reached here, from which the client's requirements come")
    assert outcome.returncode == 0, outcome.stderr
    return folder


@pytest.fixture(autouse=True)
def no_source(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing of the checkout can be imported where the wheel is installed."""
    monkeypatch.delenv("PYTHONPATH", raising=False)


def python_of(minor: int) -> Path:
    """A Python 3 of this minor version: on PATH, or beside the one that runs the tests."""
    name = f"python3.{minor}"
    beside = sorted(Path(sys.base_prefix).parent.glob(f"*/bin/{name}"))
    for found in (*([Path(named)] if (named := shutil.which(name)) else []), *beside):
        if subprocess.run([found, "--version"], check=False, capture_output=True).returncode == 0:
            return found
    pytest.skip(f"no {name} is on this machine, neither on PATH nor beside {sys.base_prefix}")


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    with serving_world(tmp_path) as (world, url):
        yield joined(world, url)


def stone(
    empty: Path, folder: Path, *arguments: str | Path, token: str = "", url: str = ""
) -> subprocess.CompletedProcess[str]:
    known = environment(folder / "data", STONE_URL=url, STONE_TOKEN=token, PYTHONSAFEPATH="1")
    command = [str(empty / "bin" / "stone"), *map(str, arguments)]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=300, cwd=folder, env=known)


def packages_of(empty: Path) -> set[str]:
    listing = [empty / "bin" / "python", "-m", "pip", "list", "--format", "freeze", "--disable-pip-version-check"]
    said = subprocess.run(listing, check=True, capture_output=True, text=True).stdout
    return {line.partition("==")[0].lower() for line in said.splitlines()} - {"pip", "setuptools"}


def test_the_wheel_is_small_and_holds_the_clients_packages_and_the_licence(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    assert wheel.stat().st_size <= MOST_BYTES
    folders = {name.partition("/")[0] for name in names}
    dist_info = f"stone_client-{own_release()}.dist-info"
    assert folders == {"stone_client", dist_info}, "one import root"
    assert "stone_client/LICENSE" in names
    assert not [name for name in names if "__pycache__" in name]


@pytest.mark.release
def test_few_packages_come_along_and_none_of_the_platforms(empty: Path) -> None:
    """Catches alone a requirement that brings the platform's packages to every participant."""
    found = packages_of(empty)
    assert len(found) <= MOST_PACKAGES, found
    assert not found & BARRED


@pytest.mark.release
def test_a_script_of_a_user_is_typed_by_what_the_wheel_holds(empty: Path, tmp_path: Path) -> None:
    """Catches alone a wheel without its marker of types."""
    script = "from stone_client import Stone\n\nreveal_type(Stone().labels('forest')['semantics'])\n"
    (tmp_path / "user.py").write_text(script)
    typing = [sys.executable, "-m", "mypy", "--strict", "--python-executable", str(empty / "bin" / "python"), "user.py"]
    checked = subprocess.run(typing, check=False, capture_output=True, text=True, cwd=tmp_path)
    assert checked.returncode == 0, checked.stdout
    assert "unsignedinteger" in checked.stdout


@pytest.mark.release
def test_a_submission_is_validated_and_scored_by_a_running_platform(
    empty: Path, served: Served, tmp_path: Path
) -> None:
    """Catches alone a module that the client needs and its wheel lacks."""
    known = {"token": served.captain.secret, "url": served.url}
    predictions = zipped(served, tmp_path / "run.zip")
    checked = stone(empty, tmp_path, "validate", predictions, *served.at("val"), **known)
    assert (checked.returncode, checked.stdout) == (0, "valid\n"), checked.stderr
    words = ("submit", predictions, *served.at("val"), "--team", served.team, "--method", "Alone", "--modality", "L")
    with scoring(served.platform):
        submitted = stone(empty, tmp_path, *words, **known)
    assert submitted.returncode == 0, submitted.stderr
    assert "mIoU" in submitted.stdout


@pytest.mark.release
def test_a_client_of_another_release_is_understood_or_told_what_to_install(empty: Path, tmp_path: Path) -> None:
    """Catches alone a wheel whose release the server does not read.

    A real process of the server; the client's release is what pip wrote down when it installed it.
    """
    (metadata,) = empty.glob(f"lib/python*/site-packages/stone_client-{own_release()}.dist-info/METADATA")
    ours = metadata.read_text("utf-8")
    with serving_process(tmp_path / "data") as running:
        known = {"token": running.token, "url": running.url}
        understood = stone(empty, tmp_path, "benchmark", "list", **known)
        before = httpx.get(f"{running.url}/api/v1/me", headers={"Authorization": f"Bearer {running.token}"})
        try:
            metadata.write_text(re.sub(r"(?m)^Version: .*$", "Version: 0.0.9", ours), "utf-8")
            refused = stone(empty, tmp_path, "benchmark", "list", **known)
        finally:
            metadata.write_text(ours, "utf-8")
    assert understood.returncode == 0, understood.stderr
    assert before.status_code == 200
    assert HEADER not in before.headers, "the release before says none, and need not know ours"
    assert refused.returncode == 1
    assert refused.stderr.startswith("client_too_old: this client has release 0.0.9")
    assert f"{running.url}/downloads/" in refused.stderr


EVERY_MODULE = """
import importlib, pkgutil, sys
import stone_client
ours = ["stone_client", "stone_base", "stone_files", "stone_submissions", "stone_exports", "stone_datasets", "stone"]
left_out = ("__main__", "devkit.tensors")
count = 0
for root in map(importlib.import_module, ours):
    for module in pkgutil.walk_packages(root.__path__, root.__name__ + "."):
        if "_vendor" not in module.name and not module.name.endswith(left_out):
            importlib.import_module(module.name)
            count += 1
print(count)
"""
TOKEN = "0" * 32


@pytest.mark.release
@pytest.mark.parametrize("minor", [10, 11, 12, 13])
def test_it_runs_on_each_python_that_it_names(minor: int, wheel: Path, tmp_path: Path) -> None:
    """Every module is loaded, and a submission scored; a version that is not on this machine is skipped by name."""
    venv = installed(wheel, python_of(minor), tmp_path / "venv")
    loaded = [venv / "bin" / "python", "-W", "error", "-c", EVERY_MODULE]
    outcome = subprocess.run(loaded, check=False, capture_output=True, text=True, cwd=tmp_path)
    assert outcome.returncode == 0, outcome.stderr
    assert int(outcome.stdout) > 150
    grid = np.zeros((256, 256, 32), np.uint8)
    grid[100:150, 100:150, 10] = 1
    (tmp_path / "gts" / "forest" / TOKEN).mkdir(parents=True)
    np.savez_compressed(tmp_path / "gts" / "forest" / TOKEN / "labels.npz", semantics=grid)
    with zipfile.ZipFile(tmp_path / "sub.zip", "w") as archive, archive.open(f"{TOKEN}.npz", "w") as member:
        np.savez_compressed(member, semantics=grid)
    scored = stone(venv, tmp_path, "score", "sub.zip", "--ground-truth", ".", "--json")
    assert scored.returncode == 0, scored.stderr
    assert json.loads(scored.stdout)["total"]["iou_t"] == 1.0


STAND_IN = {
    "stone/__init__.py": "",
    "stone/theirs.py": "def main():\n    print('theirs')\n",
    "stone-3.5.dist-info/METADATA": "Metadata-Version: 2.1\nName: stone\nVersion: 3.5\n",
    "stone-3.5.dist-info/WHEEL": "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    "stone-3.5.dist-info/entry_points.txt": "[console_scripts]\nstone = stone.theirs:main\n",
    "stone-3.5.dist-info/RECORD": "",
}


@pytest.mark.release
def test_beside_the_distribution_stone_of_others_the_client_runs_by_its_own_name(wheel: Path, tmp_path: Path) -> None:
    """Catches alone a client that cannot be started, or finds no module, once their package and script are there."""
    venv = installed(wheel, sys.executable, tmp_path / "venv")
    distribution = tmp_path / "stone-3.5-py3-none-any.whl"
    with zipfile.ZipFile(distribution, "w") as theirs:
        for name, text in STAND_IN.items():
            theirs.writestr(name, text)
    adding = [venv / "bin" / "pip", "install", "--quiet", "--no-deps", "--no-index", distribution]
    subprocess.run(adding, check=True)
    python = str(venv / "bin" / "python")
    for words in ([str(venv / "bin" / "stone-client")], [python, "-m", "stone_client"]):
        known = environment(tmp_path / "data", PYTHONSAFEPATH="1")
        said = subprocess.run([*words, "--version"], check=True, capture_output=True, text=True, env=known)
        assert said.stdout.startswith(f"stone {own_release()} (Python ")
        outcome = subprocess.run([*words, "score", "--help"], check=True, capture_output=True, text=True, env=known)
        assert "Score a submission" in outcome.stdout
    (tmp_path / "use.py").write_text("from stone_client import Stone\nimport stone.scoring.score_record\n")
    subprocess.run([python, tmp_path / "use.py"], check=True)
    assert subprocess.run([venv / "bin" / "stone"], capture_output=True, text=True, check=True).stdout == "theirs\n"
