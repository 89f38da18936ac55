"""What every test may ask for: the folder of real recordings, where this machine has one."""

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


@pytest.fixture(scope="session")
def field_data() -> Path:
    """The folder of real recordings by others; never part of the project, so absent on most machines."""
    folder = field_folder()
    if not folder.is_dir():
        pytest.skip(f"no field data at {folder}; set {VARIABLE} to the folder that holds it")
    return folder
