"""An image holds what its role imports, in the versions that are tested, and nothing of the other roles' weight."""

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

from services.runtime.processes.worker import services_of
from tests.deploy.images.reach import needed_distributions

ROOT = Path(__file__).resolve().parents[3]
IMAGES = ROOT / "deploy" / "images"
RUNTIME = ("services.runtime.processes.worker", "services.runtime.processes.health_check")
ENTRIES = {
    "api": (
        "services.runtime.processes.api",
        "services.runtime.processes.prepare",
        "services.runtime.processes.health_check",
        "services.maintenance.sweeper",
        "services.runtime.backup.__main__",
        "web.main",
        "api.middleware.heads",
    ),
    **{
        role: (*RUNTIME, *(f"services.{service}.tasks" for service in services_of((role,))))
        for role in ("ingest", "labeler", "eval")
    },
}
LOADED_BY_NAME = {
    "api": {"uvloop", "httptools", "python-multipart", "psycopg", "psycopg-binary"},
    "ingest": {"psycopg", "psycopg-binary"},
    "labeler": {"psycopg", "psycopg-binary"},
    "eval": {"psycopg", "psycopg-binary"},
}
HEAVY = {
    "api": {"open3d-cpu", "numba", "llvmlite", "kiss-icp", "av"},
    "ingest": {"open3d-cpu", "fastapi", "uvicorn"},
    "labeler": {"fastapi", "uvicorn"},
    "eval": {"open3d-cpu", "fastapi", "uvicorn", "rosbags", "pyarrow", "matplotlib"},
}


@pytest.fixture(scope="module")
def locks() -> ModuleType:
    spec = importlib.util.spec_from_file_location("image_locks", IMAGES / "locks.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def pinned(path: Path) -> dict[str, set[str]]:
    """`name==version` and its hashes."""
    text = re.sub(r"\\\n", " ", re.sub(r"(?m)^\s*#.*\n", "", path.read_text("utf-8")))
    return {line.split()[0]: set(re.findall(r"--hash=(\S+)", line)) for line in text.splitlines()}


def names(path: Path) -> set[str]:
    return {requirement.partition("==")[0] for requirement in pinned(path)}


@pytest.mark.parametrize("role", ENTRIES)
def test_the_lock_is_what_the_script_makes(locks: ModuleType, role: str) -> None:
    assert (IMAGES / f"{role}.lock").read_text("utf-8") == locks.lock_of(role), "run python deploy/images/locks.py"


@pytest.mark.parametrize("role", ENTRIES)
def test_versions_and_hashes_are_those_of_the_main_lock(role: str) -> None:
    everything = pinned(ROOT / "requirements.lock")
    of_role = pinned(IMAGES / f"{role}.lock")
    assert len(of_role) > 30
    assert of_role.items() <= everything.items()
    assert all(of_role.values()), "each is checked by its hash"


@pytest.mark.parametrize("role", ENTRIES)
def test_what_a_role_imports_is_in_its_lock(role: str) -> None:
    needed = needed_distributions(ENTRIES[role])
    missing = {name: importer for name, importer in needed.items() if name not in names(IMAGES / f"{role}.lock")}
    assert len(needed) > 10
    assert not missing, "add it to the role's group in pyproject.toml and run python deploy/images/locks.py"
    assert names(IMAGES / f"{role}.lock") >= LOADED_BY_NAME[role]


@pytest.mark.parametrize("role", ENTRIES)
def test_an_image_does_not_carry_the_weight_of_other_roles(role: str) -> None:
    assert not names(IMAGES / f"{role}.lock") & HEAVY[role]


def test_the_tools_are_locked_in_the_versions_of_the_main_lock_where_that_has_them() -> None:
    main = {requirement.partition("==")[0]: requirement for requirement in pinned(ROOT / "requirements.lock")}
    tools = pinned(IMAGES / "build.lock")
    assert {"hatchling", "cyclonedx-bom"} <= names(IMAGES / "build.lock")
    assert all(tools.values())
    for requirement in tools:
        assert main.get(requirement.partition("==")[0], requirement) == requirement
