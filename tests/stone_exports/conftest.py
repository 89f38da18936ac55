"""A small export of all sensors, and copies of it that lie."""

from pathlib import Path
from shutil import copytree

import pytest

from testing.worlds.small_export import CAMERAS, SmallExport, write_small_export

RIG = SmallExport(frames=2, cameras=CAMERAS, radars=("RADAR_FRONT",))


@pytest.fixture(scope="session")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two frames of six cameras, a LiDAR and a radar; nothing in it may be changed."""
    return write_small_export(tmp_path_factory.mktemp("rig"), RIG)


@pytest.fixture
def copied(rig: Path, tmp_path: Path) -> Path:
    """The same, to be changed."""
    copytree(rig, tmp_path / "copied")
    return tmp_path / "copied"
