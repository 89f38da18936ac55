"""A role starts with what its lock holds and nothing else, whatever the packages of others import unsaid."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.deploy.test_locks import ENTRIES, names

ROOT = Path(__file__).resolve().parents[3]
LOADED = """
import importlib, sys
from importlib.abc import MetaPathFinder
from importlib.metadata import packages_distributions
from packaging.utils import canonicalize_name

locked = set(sys.argv[1].split(","))
ours = {
    "stone", "stone_base", "stone_files", "stone_recordings", "stone_submissions", "services", "simulator",
    "stone_client", "stone_local", "api", "web",
}
known = packages_distributions()
absent = {
    package for package, distributions in known.items()
    if package not in ours and not {canonicalize_name(name) for name in distributions} & locked
}
for package in [name for name in sys.modules if name.partition(".")[0] in absent | {"packaging"}]:
    del sys.modules[package]

class OnlyLocked(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in absent:
            raise ModuleNotFoundError(f"No module named {name!r} in this image", name=name)
        return None

sys.meta_path.insert(0, OnlyLocked())
for module in sys.argv[2:]:
    importlib.import_module(module)
from services.runtime.jobs.celery_app import app
app.connection_for_write().transport
print("loaded")
"""


@pytest.mark.release
@pytest.mark.parametrize("role", ENTRIES)
def test_a_role_loads_with_the_packages_of_its_image_alone(role: str, tmp_path: Path) -> None:
    """Catches alone a missing package that only another package imports."""
    modules = [module for module in ENTRIES[role] if not module.endswith("__main__")]
    lock = ",".join(names(ROOT / "deploy" / "images" / f"{role}.lock"))
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "STONE_DATA_FOLDER": str(tmp_path)}
    outcome = subprocess.run(
        [sys.executable, "-c", LOADED, lock, *modules],
        check=False, capture_output=True, text=True, env=environment, cwd=tmp_path, timeout=300,
    )  # fmt: skip
    assert outcome.returncode == 0, outcome.stderr[-3000:]
    assert outcome.stdout.endswith("loaded\n")
