"""`stone inspect` on what people name by mistake, and on a simulated recording."""

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from stone_client.main import app

REFUSAL = re.compile(r"[A-Za-z]+[-_A-Za-z0-9]*: \S.*")


def inspect(path: Path, *options: str) -> Result:
    return CliRunner().invoke(app, ["inspect", str(path), *options])


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    bag = tmp_path_factory.mktemp("recording") / "run.mcap"
    simulate(bag, SimulateOptions(seconds=1.0, channels=16, columns=180, cameras=False))
    return bag


def test_json_is_one_object_with_every_topic(recording: Path) -> None:
    result = inspect(recording, "--json")
    assert result.exit_code == 0
    record = json.loads(result.stdout)
    assert record["duration_ns"] > 10**9
    lidar = next(topic for topic in record["topics"] if topic["role"] == "lidar")
    assert (lidar["type"], lidar["count"]) == ("sensor_msgs/msg/PointCloud2", 10)
    assert lidar["rate_hz"] == pytest.approx(10.0, abs=0.01)
    assert {"ins", "imu", "radar", "tf_static"} <= {topic["role"] for topic in record["topics"]}
    for finding in record["findings"]:
        assert set(finding) == {"code", "severity", "topic", "message"}


def test_people_get_a_row_for_each_topic_and_a_line_for_each_finding(recording: Path) -> None:
    result = inspect(recording)
    record = json.loads(inspect(recording, "--json").stdout)
    for topic in record["topics"]:
        assert topic["name"] in result.stdout
    *told, last = result.stderr.splitlines()
    assert len(told) == len(record["findings"])
    assert last.startswith("`stone explain ")


@pytest.mark.parametrize(
    "content",
    [b"<!doctype html><title>Sign in</title>", b"", b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" + bytes(500), b"#ROSBAG V2.0\n"],
    ids=["a login page", "nothing", "only the magic", "zeros", "ROS 1"],
)
def test_what_is_no_recording_is_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "run.mcap").write_bytes(content)
    result = inspect(tmp_path / "run.mcap", "--json")
    assert result.exit_code == 1
    assert REFUSAL.fullmatch(result.stderr.rstrip("\n"))
    assert json.loads(result.stdout)["findings"][0]["severity"] == "error"


def test_a_recording_that_was_cut_off_says_where(tmp_path: Path, recording: Path) -> None:
    whole = recording.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    result = inspect(tmp_path / "cut.mcap")
    assert "cut off" in result.stderr
    assert "Traceback" not in result.stderr


def test_with_a_calibration_labelling_is_looked_ahead_to(recording: Path) -> None:
    rig = calibration_path(recording)
    plain, checked = inspect(recording, "--json"), inspect(recording, "--json", "--calibration", str(rig))
    assert (plain.exit_code, checked.exit_code) == (0, 0)
    codes = [{found["code"] for found in json.loads(one.stdout)["findings"]} for one in (plain, checked)]
    assert codes[0] <= codes[1]
    rig_of_nothing = recording.with_name("other.yaml")
    rig_of_nothing.write_text("stone_calibration: 1\nname: none\n")
    refused = inspect(recording, "--calibration", str(rig_of_nothing))
    assert refused.exit_code == 1
