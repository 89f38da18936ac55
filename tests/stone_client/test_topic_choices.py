"""Choices of topics on the command line: tried with `stone inspect`, saved, and used again."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from simulator.options import FAULT_NAMES, SimulateOptions
from simulator.pipeline import simulate
from stone_client.main import app

FRONT = "/camera/front/image/compressed"


def stone(*words: object) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    bag = tmp_path_factory.mktemp("recording") / "run.mcap"
    simulate(bag, SimulateOptions(seconds=0.5, channels=8, columns=48, camera_width_px=32, world_width_m=30.0))
    return bag


def channels(result: Result) -> dict[str, str]:
    found: dict[str, str] = json.loads(result.stdout)["channels"]
    return found


def test_the_whole_rig_is_resolved_and_shown(recording: Path) -> None:
    resolved = channels(stone("inspect", recording, "--json"))
    assert resolved["CAM_FRONT"] == FRONT
    assert set(resolved) == {
        "lidar", "pose", "imu", "RADAR_FRONT", "RADAR_LEFT", "RADAR_RIGHT", "CAM_FRONT", "CAM_FRONT_LEFT",
        "CAM_FRONT_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT",
    }  # fmt: skip
    assert "camera (CAM_FRONT)" in stone("inspect", recording).stdout


def test_a_choice_is_saved_and_used_for_the_next_recording(recording: Path, tmp_path: Path) -> None:
    saved = tmp_path / "rover.yaml"
    first = stone("inspect", recording, "--topic", f"CAM_BACK={FRONT}", "--save-topics", saved, "--json")
    assert channels(first)["CAM_BACK"] == FRONT
    assert "CAM_FRONT" not in channels(first)
    assert channels(stone("inspect", recording, "--topics", saved, "--json")) == channels(first)
    mended = stone("inspect", recording, "--topics", saved, "--topic", f"CAM_FRONT={FRONT}", "--json")
    assert channels(mended)["CAM_FRONT"] == FRONT


def test_a_choice_that_the_recording_does_not_bear_out_is_said(recording: Path) -> None:
    result = stone("inspect", recording, "--topic", "lidar=/imu/data")
    assert "TOP-111" in result.stderr
    assert channels(stone("inspect", recording, "--topic", "lidar=/imu/data", "--json"))["lidar"] == "/lidar_points"


def test_what_is_no_choice_is_a_mistake_of_use(recording: Path) -> None:
    result = stone("inspect", recording, "--topic", "/lidar_points")
    assert result.exit_code == 2
    assert "PART=TOPIC" in result.stderr


def test_a_part_there_is_none_is_refused_by_name(recording: Path, tmp_path: Path) -> None:
    result = stone("inspect", recording, "--topic", "sonar=/lidar_points")
    assert (result.exit_code, "sonar" in result.stderr) == (1, True)
    (tmp_path / "no.yaml").write_text("- nothing\n")
    assert "TOP-114" in stone("inspect", recording, "--topics", tmp_path / "no.yaml").stderr


def test_labels_are_refused_a_topic_that_cannot_give_poses(recording: Path, tmp_path: Path) -> None:
    rig = recording.with_name("run.calibration.yaml")
    asked = ("label", recording, "--calibration", rig, "-o", tmp_path / "labels", "--topic", "pose=/imu/data")
    result = stone(*asked)
    assert result.exit_code == 1
    assert "TOP-104" in result.stderr
    assert "/imu/data" in result.stderr


def test_faults_are_simulated_by_name_and_listed(tmp_path: Path) -> None:
    small = ("--seconds", 0.3, "--channels", 4, "--columns", 24, "--no-cameras")
    assert stone("simulate", tmp_path / "a.mcap", *small).exit_code == 0
    assert stone("simulate", tmp_path / "b.mcap", *small, "--fault", "clock_37s", "--fault", "rtk_gap").exit_code == 0
    assert (tmp_path / "a.mcap").read_bytes() != (tmp_path / "b.mcap").read_bytes()
    bad_luck = stone("simulate", tmp_path / "c.mcap", *small, "--fault", "bad_luck")
    assert bad_luck.exit_code != 0
    assert all(name in bad_luck.stderr.replace("\n", " ") for name in FAULT_NAMES)
