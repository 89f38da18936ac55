"""What every test may ask for: the folder of real recordings, where this machine has one."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

from testing.field_data import VARIABLE, field_folder

pytest_plugins = [
    "testing.servers.fixtures",
    "testing.web.chromium",
    "testing.costs",
    "testing.tiers",
    "testing.memory",
    "testing.reruns",
]

# A machine that is busy is slow, and no property is about that.
settings.register_profile("busy", deadline=None)
settings.load_profile("busy")
# Numbers are held to their oracles by the run without: a few examples are enough to enter each kernel.
EXAMPLES_WHERE_INDICES_ARE_CHECKED = 5


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Where numba checks every index (`make test-kernels`), draw few examples, whatever a test asks for."""
    if os.environ.get("NUMBA_BOUNDSCHECK") != "1":
        return
    for test in {item.obj for item in items if isinstance(item, pytest.Function)}:
        own = getattr(test, "_hypothesis_internal_use_settings", None)
        if own is not None:
            fewer = min(own.max_examples, EXAMPLES_WHERE_INDICES_ARE_CHECKED)
            test._hypothesis_internal_use_settings = settings(own, max_examples=fewer)


@pytest.fixture(scope="session")
def field_data() -> Path:
    """The folder of real recordings by others; never part of the project, so absent on most machines."""
    folder = field_folder()
    if not folder.is_dir():
        pytest.skip(f"no field data at {folder}; set {VARIABLE} to the folder that holds it")
    return folder
