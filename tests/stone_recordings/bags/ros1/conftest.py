"""One short drive as MCAP; every test makes its ROS 1 bag of it."""

from pathlib import Path

import pytest

from simulator.options import SimulateOptions
from simulator.pipeline import simulate


@pytest.fixture(scope="package")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All topics of the rig: clouds, pictures, radars, INS, IMU, static transforms. Read only."""
    bag = tmp_path_factory.mktemp("drive") / "run.mcap"
    simulate(bag, SimulateOptions(seconds=1.2, channels=16, columns=120, camera_width_px=48, world_width_m=30.0))
    return bag
