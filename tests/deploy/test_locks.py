"""What is installed is what is imported, in the versions that are tested: by `make install`, by every image."""

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

from services.runtime.processes.worker import services_of
from tests.deploy.images.reach import needed_distributions

ROOT = Path(__file__).resolve().parents[2]
DEPLOY = ROOT / "deploy"
IMAGES = DEPLOY / "images"
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
PRODUCT = ("stone_client", "stone_local", "services", "simulator", "api", "web")
OF_CALLERS = {"pandas"}  # tables of the SDK, if the caller has it
OF_MODELS = {"torch", "safetensors", "tensorboard", "onnx", "onnxruntime", "onnxscript"}  # .venv-baselines
ONLY_DEVELOPERS = {
    "pytest",
    "mypy",
    "playwright",
    "hypothesis",
    "ruff",
    "mkdocs",
    "pip-audit",
    "atheris",
    "schemathesis",
}
CUT = [path.relative_to(DEPLOY).as_posix() for path in (*DEPLOY.glob("*.lock"), *IMAGES.glob("*.lock"))]
RESOLVED = {"node.lock", "uv.lock", "images/build.lock"}  # of tools, each with a file of its own that asks for them
LOADED_BY_NAME = {
    "api": {"uvloop", "httptools", "python-multipart", "psycopg", "psycopg-binary"},
    "ingest": {"psycopg", "psycopg-binary"},
    "labeler": {"psycopg", "psycopg-binary"},
    "eval": {"psycopg", "psycopg-binary"},
}


@pytest.fixture(scope="module")
def locks() -> ModuleType:
    spec = importlib.util.spec_from_file_location("locks", DEPLOY / "locks.py")
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


def product_modules() -> list[str]:
    """Every module that is run from a checkout, but those of models."""
    paths = [path for package in PRODUCT for path in (ROOT / package).rglob("*.py") if "node_modules" not in path.parts]
    names = [path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".") for path in paths]
    return [name.removesuffix(".__init__") for name in names if ".models" not in name]


def test_every_lock_of_packages_is_cut_out_of_the_main_one(locks: ModuleType) -> None:
    assert set(CUT) - RESOLVED == set(locks.LOCKS)


@pytest.mark.parametrize("lock", sorted(set(CUT) - RESOLVED))
def test_the_lock_is_what_the_script_makes(locks: ModuleType, lock: str) -> None:
    assert (DEPLOY / lock).read_text("utf-8") == locks.lock_of(locks.LOCKS[lock]), "run python deploy/locks.py"


@pytest.mark.parametrize("lock", sorted(set(CUT) - RESOLVED))
def test_versions_and_hashes_are_those_of_the_main_lock(lock: str) -> None:
    everything = pinned(ROOT / "requirements.lock")
    cut = pinned(DEPLOY / lock)
    assert len(cut) > 30
    assert cut.items() <= everything.items()
    assert all(cut.values()), "each is checked by its hash"


def test_make_install_installs_what_the_product_imports_and_nothing_of_developers() -> None:
    installed = names(DEPLOY / "runtime.lock")
    needed = needed_distributions(product_modules())
    assert len(needed) > 40
    assert set(needed) - OF_MODELS - OF_CALLERS - {"stone-client", "stone-platform"} <= installed, (
        "declare it in pyproject.toml"
    )
    assert not installed & ONLY_DEVELOPERS


@pytest.mark.parametrize("role", ENTRIES)
def test_what_a_role_imports_is_in_its_lock(role: str) -> None:
    needed = needed_distributions(ENTRIES[role])
    missing = {name: importer for name, importer in needed.items() if name not in names(IMAGES / f"{role}.lock")}
    assert len(needed) > 10
    assert not missing, "add it to the role's group in pyproject.toml and run python deploy/locks.py"
    assert names(IMAGES / f"{role}.lock") >= LOADED_BY_NAME[role]
