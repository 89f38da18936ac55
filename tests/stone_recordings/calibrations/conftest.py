"""One short drive of the simulated rig with pictures, synchronised once."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from services.ingest.sequence import open_sequence
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path
from stone.sensors.sequence import Sequence
from stone_recordings.sync.sweeps import BagSweeps
from testing.worlds.drives import drive as simulated_once

DRIVE = SimulateOptions(seconds=1.5, seed=3, channels=32, columns=450, camera_width_px=240, world_width_m=50.0)


@dataclass(frozen=True, eq=False)
class Drive:
    path: Path
    sequence: Sequence
    sweeps: BagSweeps


@pytest.fixture(scope="package")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    path = simulated_once(tmp_path_factory, DRIVE)
    return Drive(path, *open_sequence(path, calibration_path(path), "drive"))
