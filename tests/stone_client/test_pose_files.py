"""`--poses FILE --poses-frame FRAME` of `stone inspect` and `stone label`."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from typer.testing import CliRunner

from simulator.calibration_yaml import write_calibration
from stone_client.main import app
from testing.worlds.pose_files import tum_text
from tests.stone_recordings import rigs
from tests.stone_recordings.rigs import PERIOD_NS, T0_NS, plain_sweep, written

STAMPS_NS = T0_NS + np.arange(8) * PERIOD_NS


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return written(tmp_path / "run.mcap", [plain_sweep(int(stamp)) for stamp in STAMPS_NS])


def run(*words: object) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words])


def test_inspect_takes_a_file_for_a_source_of_poses(bag: Path, tmp_path: Path) -> None:
    assert "TOP-103" in run("inspect", bag).stderr
    poses = tmp_path / "poses.txt"
    poses.write_text(tum_text(STAMPS_NS, rigs.world_from_ego(STAMPS_NS)))
    told = run("inspect", bag, "--poses", poses, "--poses-frame", "base_link")
    assert (told.exit_code, "TOP-103" in told.stderr, "SYN-5" in told.stderr) == (0, False, False)


def test_a_bad_line_is_named(bag: Path, tmp_path: Path) -> None:
    poses = tmp_path / "poses.txt"
    poses.write_text("1 2 3\n")
    assert "SYN-516: poses.txt, line 1: the line has 3 words" in run("inspect", bag, "--poses", poses).stderr


def test_a_calibration_is_checked_with_the_poses_of_a_file(bag: Path, tmp_path: Path) -> None:
    calibration, poses = tmp_path / "rig.yaml", tmp_path / "poses.txt"
    write_calibration(rigs.calibration(), calibration)
    check = ("calibration", "check", calibration, "--bag", bag, "--poses", poses, "--poses-frame")
    poses.write_text(tum_text(STAMPS_NS, rigs.world_from_ego(STAMPS_NS)))
    assert "SYN-5" not in run(*check, "base_link").stderr
    assert "SYN-517: poses.txt: unknown frame 'chassis'" in run(*check, "chassis").stderr


def test_a_file_and_a_topic_are_not_taken_together(bag: Path, tmp_path: Path) -> None:
    poses = tmp_path / "poses.txt"
    poses.write_text("")
    calibration = tmp_path / "rig.yaml"
    calibration.write_text("")
    label = ("label", bag, "--calibration", calibration, "-o", tmp_path / "labels")
    refused = run(*label, "--poses", poses, "--odometry", "/odom")
    assert refused.exit_code == 2
    assert "--poses" in refused.stderr
