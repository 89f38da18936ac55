"""The client's distribution: of the platform's release, of its own packages, and with few requirements."""

import ast
import json
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from packaging.requirements import Requirement

from api.client_wheel import FILENAME, ClientWheel, install_line
from testing.worlds.released_datasets import ReleasedDataset, write_released_zip

ROOT = Path(__file__).resolve().parents[3]


def project(folder: Path) -> dict[str, Any]:
    return tomllib.loads((folder / "pyproject.toml").read_text("utf-8"))


def vendored(name: str = "VENDORED") -> tuple[str, ...]:
    """What the hook of the client's build says, without hatchling, which is not installed here."""
    hook = ast.parse((ROOT / "deploy" / "client" / "packages_hook.py").read_text("utf-8"))
    said = (node for node in hook.body if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name)
    found: tuple[str, ...] = ast.literal_eval(next(said).value)
    return found


def test_client_and_platform_are_of_one_release_and_the_platform_asks_for_that() -> None:
    ours, client = project(ROOT)["project"], project(ROOT / "deploy" / "client")["project"]
    assert client["version"] == ours["version"]
    assert f"stone-client=={ours['version']}" in ours["dependencies"]


def test_pages_for_readers_name_the_release() -> None:
    release = project(ROOT)["project"]["version"]
    assert f"\nversion: {release}\n" in read("CITATION.cff")
    assert f"\n## {release} (" in read("CHANGELOG.md")
    assert f"Version {release} " in read("README.md")
    assert f"version = {{{release}}}" in read("docs/citing.md")


def test_the_platforms_wheel_holds_every_package_but_the_client_and_the_manual_names_them() -> None:
    of_platform = project(ROOT)["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
    roots: list[str] = project(ROOT)["tool"]["importlinter"]["root_packages"]
    assert sorted([*of_platform, "stone_client"]) == sorted(roots)
    assert set(vendored()) < set(of_platform), "where both are installed, the platform's are imported"
    (sentence,) = re.findall(r"installs these: (.+?)\.", read("docs/operations/install.md"), re.DOTALL)
    assert re.findall(r"`(\w+)`", sentence) == of_platform


def read(page: str) -> str:
    return (ROOT / page).read_text("utf-8")


def test_the_participants_guide_begins_with_the_line_that_the_page_shows() -> None:
    line = install_line("http://127.0.0.1:8080", ClientWheel(FILENAME, b""))
    first = (ROOT / "docs" / "participant.md").read_text("utf-8").split("```")[1]
    assert first.strip().endswith(f".venv/bin/{line}")


def test_versions_that_the_client_takes_are_those_of_the_platform() -> None:
    ours = {Requirement(line).name: line for line in project(ROOT)["project"]["dependencies"]}
    for line in project(ROOT / "deploy" / "client")["project"]["dependencies"]:
        assert ours[Requirement(line).name] == line


OPENED = """
import sys
for barred in ("numba", "scipy", "torch", "pyarrow", "pydantic", "stone_local", "services"):
    sys.modules[barred] = None
from stone_client.devkit import open_dataset
dataset = open_dataset("STONE.zip")
frame = dataset[0]
print(len(dataset), len(dataset.drives), frame.semantics.shape, frame.sweep.shape[1], frame.image("CAM_FRONT").shape)
ours = [one.__file__ for name, one in sys.modules.items() if name.startswith("stone") and one]
print(all(path.startswith(sys.argv[1]) for path in ours))
"""


SCORED = """
import sys
for barred in ("numba", "scipy", "torch", "pyarrow", "pydantic_settings", "stone_local", "services"):
    sys.modules[barred] = None
from stone_client.main import main
main()
"""


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The content of the wheel, as pip lays it out."""
    wheel = tmp_path_factory.mktemp("alone") / "wheel"
    shutil.copytree(ROOT / "stone_client", wheel / "stone_client")
    below = wheel / "stone_client" / "_vendor"
    for package in vendored():
        shutil.copytree(ROOT / package, below / package)
    for module in vendored("SCIENCE"):
        (below / "stone" / module).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / "stone" / module, below / "stone" / module)
    return wheel


def run_alone(wheel: Path, folder: Path, program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """The program in `folder`, where nothing of ours can be imported but what the wheel holds."""
    known = {"PYTHONPATH": f"{wheel}:{wheel / 'stone_client' / '_vendor'}", "PYTHONSAFEPATH": "1"}
    command = [sys.executable, "-c", program, *arguments]
    return subprocess.run(command, check=False, capture_output=True, text=True, cwd=folder, env=known)


def test_the_devkit_opens_the_release_with_what_the_wheel_holds_alone(alone: Path, tmp_path: Path) -> None:
    """Catches alone a module that the devkit loads and the wheel lacks."""
    write_released_zip(tmp_path / "STONE.zip", ReleasedDataset(cameras=("CAM_FRONT",)))
    outcome = run_alone(alone, tmp_path, OPENED, str(alone))
    assert outcome.stdout.splitlines() == ["8 1 (200, 200, 16) 4 (48, 64, 3)", "True"], outcome.stderr


def test_a_submission_is_scored_with_what_the_wheel_holds_alone(alone: Path, tmp_path: Path) -> None:
    """Catches alone a module that scoring loads and the wheel lacks."""
    grid = np.zeros((256, 256, 32), np.uint8)
    grid[100:150, 100:150, 10], grid[20:30, 20:30, 5:20] = 1, 3
    (tmp_path / "gts" / "forest" / ("0" * 32)).mkdir(parents=True)
    np.savez_compressed(tmp_path / "gts" / "forest" / ("0" * 32) / "labels.npz", semantics=grid)
    with zipfile.ZipFile(tmp_path / "sub.zip", "w") as archive, archive.open("0" * 32 + ".npz", "w") as member:
        np.savez_compressed(member, semantics=np.where(grid == 3, 2, grid))
    outcome = run_alone(alone, tmp_path, SCORED, "score", "sub.zip", "--ground-truth", ".", "--json")
    assert outcome.returncode == 0, outcome.stderr
    assert json.loads(outcome.stdout)["total"] == {
        "iou_occ": 1.0,
        "iou_t": 1.0,
        "iou_p": 0.0,
        "iou_n": 0.0,
        "miou": 1 / 3,
    }


def test_the_baseline_is_loaded_from_what_the_wheel_holds_alone(alone: Path, tmp_path: Path) -> None:
    """Catches alone a module that the baseline loads and the wheel lacks."""
    (tmp_path / "m.json").write_text(json.dumps({"stone_manifest": 1, "sequences": {"forest": ["0" * 32]}}))
    outcome = run_alone(alone, tmp_path, SCORED, "baseline", ".", "--manifest", "m.json", "-o", "sub.zip")
    assert outcome.stderr.startswith("not_an_export: "), outcome.stderr


PROVOKED = """
import sys
import stone_client
print(sys.path.index(sys.argv[1]))
import stone.errors
print(stone.errors.__file__.startswith(sys.argv[1]))
"""


@pytest.mark.parametrize("is_beside", [False, True], ids=["alone", "beside the platform"])
def test_another_distributions_package_stone_hides_nothing_of_ours(
    alone: Path, tmp_path: Path, is_beside: bool
) -> None:
    """Beside the platform its packages are imported, so that each class exists once."""
    theirs, below = tmp_path / "theirs", alone / "stone_client" / "_vendor"
    (theirs / "stone").mkdir(parents=True)
    (theirs / "stone" / "__init__.py").write_text("")
    if is_beside:
        shutil.copytree(below / "stone", theirs / "stone", dirs_exist_ok=True)
        (theirs / "stone_local").mkdir()
    known = {"PYTHONPATH": f"{theirs}:{alone}", "PYTHONSAFEPATH": "1"}
    command = [sys.executable, "-S", "-c", PROVOKED, str(below)]  # without the checkout that is installed in place
    outcome = subprocess.run(command, check=True, capture_output=True, text=True, cwd=tmp_path, env=known)
    place, is_ours = outcome.stdout.split()
    assert (int(place) > 0, is_ours) == (is_beside, str(not is_beside))


def test_the_command_has_a_name_that_no_other_distribution_has_and_runs_as_a_module(
    alone: Path, tmp_path: Path
) -> None:
    scripts = project(ROOT / "deploy" / "client")["project"]["scripts"]
    assert scripts["stone-client"] == scripts["stone"]
    known = {"PYTHONPATH": f"{alone}:{sysconfig.get_path('purelib')}", "PYTHONSAFEPATH": "1"}
    command = [sys.executable, "-S", "-m", "stone_client", "--version"]
    outcome = subprocess.run(command, check=True, capture_output=True, text=True, cwd=tmp_path, env=known)
    assert outcome.stdout.startswith("stone ")


NEWER = {
    "enum": {"StrEnum"},
    "datetime": {"UTC"},
    "hashlib": {"file_digest"},
    "typing": {"Self"},
    "tomllib": set[str](),
}


def test_the_client_takes_nothing_from_a_standard_library_newer_than_its_oldest_python() -> None:
    """`stone_base.newer_python` has it; what each Python really loads: tests/deploy/client/test_wheel.py."""
    assert project(ROOT / "deploy" / "client")["project"]["requires-python"] == ">=3.10"
    packages = [ROOT / name for name in ("stone_client", *vendored())]
    paths = [path for package in packages for path in package.rglob("*.py")]
    paths += [ROOT / "stone" / module for module in vendored("SCIENCE")]
    newer = [
        f"{path.relative_to(ROOT)}: {node.module}"
        for path in paths
        if path.name != "newer_python.py"
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.ImportFrom) and node.module in NEWER
        if {name.name for name in node.names} & (NEWER[node.module] or {name.name for name in node.names})
    ]
    assert newer == []
