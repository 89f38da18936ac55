"""`stone calibration`: what it says of a file alone and of a file against a recording, as people and programs ask."""

import json
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML
from typer.testing import CliRunner, Result

from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from stone_client.main import app

KITTI = """\
P2: 721.5 0 609.5 44.9 0 721.5 172.8 0.2 0 0 1 0.003
R0_rect: 1 0 0 0 1 0 0 0 1
Tr_velo_to_cam: 0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.27
"""
NATIVE = """\
stone_calibration: 1
name: bare
ego_from_lidar: {translation_m: [0.1, 0, 0.95], rotation_wxyz: [1, 0, 0, 0]}
"""


def calibration(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, ["calibration", *map(str, arguments)])


def answered(*arguments: str | Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(calibration(*arguments, "--json").stdout)
    return found


def codes(record: dict[str, Any], severity: str = "") -> list[str]:
    return [one["code"] for one in record["findings"] if not severity or one["severity"] == severity]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    bag = tmp_path_factory.mktemp("recording") / "run.mcap"
    simulate(bag, SimulateOptions(seconds=3.0, seed=3, channels=32, columns=360, cameras=False))
    return bag


@pytest.fixture
def native(tmp_path: Path) -> Path:
    (tmp_path / "bare.yaml").write_text(NATIVE)
    return tmp_path / "bare.yaml"


def changed(run: Path, tmp_path: Path, change: Any) -> Path:
    """The recording's calibration with something else in it."""
    yaml = YAML(typ="safe")
    content = yaml.load(calibration_path(run).read_text())
    change(content)
    path = tmp_path / "changed.yaml"
    with path.open("w") as stream:
        yaml.dump(content, stream)
    return path


def test_a_file_alone_is_told_with_its_mounts_lenses_and_gaps(run: Path, native: Path) -> None:
    record = answered("check", calibration_path(run))
    assert (record["format"], record["is_usable"], record["footprint"]["is_default"]) == ("native", True, False)
    sensors = {sensor["name"]: sensor for sensor in record["sensors"]}
    left = sensors["CAM_FRONT_LEFT"]
    assert [left[key] for key in ("roll_deg", "pitch_deg", "yaw_deg")] == pytest.approx([0, 0, 60], abs=1e-2)
    assert left["intrinsics"]["field_of_view_deg"][0] == pytest.approx(80, abs=0.1)
    assert (record["channels"], record["ground"], record["findings"]) == (None, None, [])
    bare = calibration("check", native)
    assert bare.exit_code == 0
    assert "footprint: 1.06 x 0.85 m (default)" in bare.stdout
    assert "vehicle: slope 20°, step 0.12 m, height 1.6 m (default)" in bare.stdout
    assert "verdict: can be used for labels" in bare.stdout
    assert bare.stderr.startswith("info: CAL-436: no footprint is given")
    assert [line.split(":")[1].strip() for line in bare.stdout.splitlines() if line.startswith("missing")] == [
        "footprint", "self_boxes_ego", "cameras", "INS",
    ]  # fmt: skip


def test_the_limits_of_a_vehicle_are_told_as_given(native: Path) -> None:
    native.write_text(NATIVE + "vehicle: {max_slope_deg: 30, height_m: 0.9}\n")
    limits = {"max_slope_deg": 30.0, "max_step_m": 0.12, "height_m": 0.9, "is_default": False}
    assert answered("check", native)["vehicle"] == limits
    assert "vehicle: slope 30°, step 0.12 m, height 0.9 m (given)" in calibration("show", native).stdout


def test_half_a_rig_is_shown_as_far_as_it_goes_and_refused(tmp_path: Path) -> None:
    (tmp_path / "calib.txt").write_text(KITTI)
    refused = calibration("check", tmp_path / "calib.txt")
    assert refused.exit_code == 1
    assert "reference <- velodyne" in refused.stdout
    assert refused.stderr.startswith("CAL-424: calib.txt is an incomplete sensor rig")
    record = answered("check", tmp_path / "calib.txt")
    assert (record["is_usable"], codes(record), record["files"][0]["format"]) == (False, ["CAL-424"], "kitti")
    (tmp_path / "noise.yaml").write_text("a: !!python/object/apply:os.system [true]\n")
    refused = calibration("show", tmp_path / "noise.yaml")
    assert (refused.exit_code, refused.stdout) == (1, "")
    assert refused.stderr.startswith("CAL-421: noise.yaml is not a YAML calibration: the tag on line 1 is not allowed")


@pytest.mark.whole
def test_a_right_calibration_fits_its_recording(run: Path) -> None:
    record = answered("check", calibration_path(run), "--bag", run)
    assert record["is_usable"]
    matched = {match["topic"]: match["sensor"] for match in record["channels"]}
    assert matched["/lidar_points"] == "LIDAR"
    assert matched["/radar/left/detections"] == "RADAR_LEFT"
    assert None not in matched.values()
    assert abs(record["ground"]["height_m"]) < 0.06
    # Its pictures were not recorded, so that the cameras have no topic; nothing else is said.
    assert codes(record) == ["CAL-437"] * 6


@pytest.mark.whole
def test_a_lidar_entered_too_low_cannot_be_used(run: Path, tmp_path: Path) -> None:
    def lower(content: dict[str, Any]) -> None:
        content["ego_from_lidar"]["translation_m"][2] -= 0.23

    low = changed(run, tmp_path, lower)
    told = calibration("check", low, "--bag", run, "--json")
    assert told.exit_code == 1
    record = json.loads(told.stdout)
    assert not record["is_usable"]
    assert record["ground"]["height_m"] == pytest.approx(-0.23, abs=0.06)
    assert codes(record, "warning") == ["CAL-414", "CAL-433"]  # the recording's own tf_static says so too
    assert codes(record, "error") == ["footprint_off_ground"]


def test_a_recording_is_checked_as_its_own_calibration(run: Path) -> None:
    record = answered("check", run, "--bag", run)
    assert record["format"] == "tf_static"
    assert record["footprint"]["is_default"]
    assert record["ground"] is not None


@pytest.mark.whole
def test_the_rig_is_drawn(run: Path, tmp_path: Path) -> None:
    assert calibration("show", calibration_path(run), "-o", tmp_path / "RIG.PNG").exit_code == 0
    assert (tmp_path / "RIG.PNG").read_bytes().startswith(b"\x89PNG")
