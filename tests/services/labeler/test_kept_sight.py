"""What the cameras of a run see is laid out once a process, and never taken for that of another run."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from services.labeler.frames import _sight_of, compute_sight_lines
from services.labeler.parameters import LabelParameters
from services.labeler.run import LabelRun
from stone.geometry.se3 import SE3
from stone.labels.grid import GRID_SHAPE
from stone.labels.sight_batches import SightBatch
from stone.labels.visibility import sight_lines
from stone.sensors.calibration import Calibration
from tests.services.labeler.worlds import CALIBRATION, CAMERA, RayCast, World, sequence_of

WORLD = World()
BACKWARD = SE3.from_parts(np.array([0.0, 0, 0, 1.0]), np.zeros(3))


def run_in(scratch: Path, calibration: Calibration = CALIBRATION) -> LabelRun:
    """Its camera's lines laid out in `scratch`."""
    sequence = replace(sequence_of(WORLD), calibration=calibration)
    run = LabelRun(sequence, RayCast(WORLD), LabelParameters(), scratch)
    compute_sight_lines(run, 0)
    return run


def test_parts_of_a_run_share_it(tmp_path: Path) -> None:
    run = run_in(tmp_path)
    assert _sight_of(run) is _sight_of(run)


def test_another_run_in_the_same_folder_sees_what_its_own_cameras_see(tmp_path: Path) -> None:
    before = _sight_of(run_in(tmp_path))
    turned = replace(CAMERA, lidar_from_sensor=BACKWARD @ CAMERA.lidar_from_sensor)
    run = run_in(tmp_path, replace(CALIBRATION, mounts=(turned,)))
    nothing = np.zeros((1, *GRID_SHAPE[:2]), np.uint32)
    assert turned.intrinsics is not None
    alone = SightBatch([sight_lines(turned.intrinsics, CALIBRATION.ego_from_lidar @ turned.lidar_from_sensor)])
    assert (_sight_of(run).visible(nothing) == alone.visible(nothing)).all()
    assert (before.visible(nothing) != alone.visible(nothing)).any()


def test_two_threads_do_not_follow_lines_in_the_same_memory(tmp_path: Path) -> None:
    run = run_in(tmp_path)
    own = _sight_of(run)
    with ThreadPoolExecutor(1) as other:
        assert other.submit(_sight_of, run).result() is not own
