"""`stone calibration init` writes what a recording knows; it is a sound calibration once each FILL_IN is replaced.

Catches alone a template that is silently taken for a calibration, or that writes over one.
"""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result
from typer.testing import CliRunner

from stone_client.main import app
from stone_recordings.calibrations.file import read_any_calibration
from testing.refusals import refused_as
from testing.worlds.field.drive import FieldDrive, FieldTopic

RUN = CliRunner()
OPTICAL = (-0.5, 0.5, -0.5, 0.5)  # x y z w
K = [400.0, 0.0, 32.0, 0.0, 410.0, 24.0, 0.0, 0.0, 1.0]


class RigDrive(FieldDrive):
    """A drive with a camera and an IMU, and what its bag says of them."""

    def transform(self, parent: str, child: str, place: tuple[float, ...], turn: tuple[float, ...]) -> Any:
        pose = self.of(
            "geometry_msgs/msg/Transform", self.vector(*place), self.of("geometry_msgs/msg/Quaternion", *turn)
        )
        return self.of("geometry_msgs/msg/TransformStamped", self.header(0.0, parent), child, pose)

    def static(self, *edges: tuple[str, str, tuple[float, ...], tuple[float, ...]]) -> FieldTopic:
        message = self.of("tf2_msgs/msg/TFMessage", [self.transform(*edge) for edge in edges])
        return FieldTopic("/tf_static", 100.0, 0.0, lambda _t: message)

    def info(self, t: float) -> Any:
        roi = self.of("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
        return self.of(
            "sensor_msgs/msg/CameraInfo", self.header(t, "cam_front_optical"), 48, 64, "plumb_bob",
            np.array([-0.1, 1e-5, 0.0, 0.0, 0.0]), np.array(K), np.eye(3).ravel(), np.zeros(12), 0, 0, roi,
        )  # fmt: skip

    def picture(self, t: float) -> Any:
        pixels = np.full(48 * 64 * 3, 90, np.uint8)
        header = self.header(t, "cam_front_optical")
        return self.of("sensor_msgs/msg/Image", header, 48, 64, "rgb8", 0, 64 * 3, pixels)


DRIVE = RigDrive()
LIDAR = ("base_link", "lidar", (0.1, 0.0, 0.95), (0.0, 0.0, 0.0, 1.0))
CAMERA = ("lidar", "cam_front_optical", (0.2, 0.0, -0.1), OPTICAL)
IMU = ("base_link", "imu_link", (0.0, 0.1, 0.5), (0.0, 0.0, 0.0, 1.0))
PICTURES = FieldTopic("/cam_front/image_raw", 0.5, 0.0, DRIVE.picture)
INFOS = FieldTopic("/cam_front/camera_info", 0.5, 0.0, DRIVE.info)
IMUS = FieldTopic("/imu", 0.02, 0.0, lambda t: DRIVE.imu(t, "imu_link"))
LENS_KEYS = [f"sensors.CAM_FRONT.intrinsics.{key}_px" for key in ("fx", "fy", "cx", "cy")]
FOOTPRINT = ["footprint.length_m", "footprint.width_m"]
EGO = ["ego_from_lidar.translation_m", "ego_from_lidar.rotation_wxyz"]


def placed(sensor: str) -> list[str]:
    return [f"sensors.{sensor}.lidar_from_sensor.{key}" for key in ("translation_m", "rotation_wxyz")]


# (further topics, the keys that nothing gives)
BAGS: dict[str, tuple[list[FieldTopic], list[str]]] = {
    "a LiDAR alone": ([], [*FOOTPRINT, *EGO]),
    "a LiDAR that tf places": ([DRIVE.static(LIDAR)], FOOTPRINT),
    "everything": ([DRIVE.static(LIDAR, CAMERA, IMU), PICTURES, INFOS, IMUS], FOOTPRINT),
    "a camera without its lens": ([DRIVE.static(LIDAR, CAMERA), PICTURES], [*FOOTPRINT, *LENS_KEYS]),
    "a camera that tf does not place": ([DRIVE.static(LIDAR), PICTURES, INFOS], [*FOOTPRINT, *placed("CAM_FRONT")]),
    "cameras and no tf": ([PICTURES], [*FOOTPRINT, *EGO, *placed("CAM_FRONT"), *LENS_KEYS]),
    "an IMU and no tf": ([IMUS], [*FOOTPRINT, *EGO, *placed("IMU")]),
}
MEASURED: dict[str, Callable[[str], str]] = {
    "translation_m: [FILL_IN, FILL_IN, FILL_IN]": lambda _: "translation_m: [0.1, 0.0, 0.95]",
    "rotation_wxyz: [FILL_IN, FILL_IN, FILL_IN, FILL_IN]": lambda _: "rotation_wxyz: [1.0, 0.0, 0.0, 0.0]",
    "length_m: FILL_IN": lambda _: "length_m: 1.0",
    "width_m: FILL_IN": lambda _: "width_m: 0.8",
    "fx_px: FILL_IN": lambda _: "fx_px: 400.0",
    "fy_px: FILL_IN": lambda _: "fy_px: 410.0",
    "cx_px: FILL_IN": lambda _: "cx_px: 32.0",
    "cy_px: FILL_IN": lambda _: "cy_px: 24.0",
}


def ran(*words: object) -> Result:
    return RUN.invoke(app, [str(word) for word in words])


def filled(text: str) -> str:
    """The template as a user completes it: nothing but the marked values."""
    body = "\n".join(line for line in text.splitlines() if not line.startswith("#"))
    for marked, value in MEASURED.items():
        body = re.sub(re.escape(marked), value, body)
    return body


@pytest.mark.parametrize("bag", BAGS)
def test_a_template_marks_what_is_missing_and_is_sound_once_that_is_filled_in(bag: str, tmp_path: Path) -> None:
    topics, missing = BAGS[bag]
    run, _ = DRIVE.write(tmp_path, DRIVE.lidar_topic(), DRIVE.odometry_topic(), *topics)
    out = tmp_path / "my-robot.yaml"
    made = ran("calibration", "init", run, "-o", out, "--json")
    assert made.exit_code == 0, made.output
    assert json.loads(made.stdout)["missing"] == missing
    with refused_as("CAL-453", match=re.escape(missing[0])):
        read_any_calibration(out)
    refused = ran("calibration", "check", out)
    assert (refused.exit_code, "CAL-453" in refused.stderr) == (1, True)
    assert all(key in refused.stderr.replace("\n", "") for key in missing)
    out.write_text(filled(out.read_text()))
    checked = ran("calibration", "check", out)
    assert checked.exit_code == 0, checked.output
    assert "can be used for labels" in checked.stdout


def test_what_the_bag_knows_stands_in_the_template(tmp_path: Path) -> None:
    topics, _ = BAGS["everything"]
    run, _ = DRIVE.write(tmp_path, DRIVE.lidar_topic(), DRIVE.odometry_topic(), *topics)
    ran("calibration", "init", run, "-o", tmp_path / "my.yaml")
    (tmp_path / "my.yaml").write_text(filled((tmp_path / "my.yaml").read_text()))
    calibration = read_any_calibration(tmp_path / "my.yaml").calibration
    assert calibration.ego_from_lidar.translation_m == pytest.approx(LIDAR[2])
    camera, imu = calibration.mount("CAM_FRONT"), calibration.mount("IMU")
    assert camera is not None
    assert imu is not None
    assert camera.lidar_from_sensor.translation_m == pytest.approx(CAMERA[2])
    assert camera.lidar_from_sensor.wxyz == pytest.approx(np.roll(OPTICAL, 1))
    assert imu.lidar_from_sensor.translation_m == pytest.approx(np.subtract(IMU[2], LIDAR[2]))
    lens = camera.intrinsics
    assert lens is not None
    assert (lens.width_px, lens.height_px, lens.fx_px, lens.cy_px) == (64, 48, 400.0, 24.0)
    assert lens.distortion == (-0.1, 1e-5, 0.0, 0.0, 0.0)


def test_an_existing_file_is_never_overwritten(tmp_path: Path) -> None:
    run, calibration = DRIVE.write(tmp_path, DRIVE.lidar_topic())
    before = calibration.read_bytes()
    made = ran("calibration", "init", run, "-o", calibration)
    assert (made.exit_code, "output_exists" in made.stderr) == (1, True)
    assert calibration.read_bytes() == before


def test_names_of_strangers_stay_names(tmp_path: Path) -> None:
    drive = FieldDrive()
    frame = 'a"\nsensors: {x: 1} # ä\u2028'
    lidar = FieldTopic("/points", 0.1, 0.0, lambda t: drive.velodyne(t, frame))
    run, _ = drive.write(tmp_path, lidar, FieldTopic("/imu", 0.02, 0.0, lambda t: drive.imu(t, frame)))
    out = tmp_path / "my.yaml"
    assert ran("calibration", "init", run, "-o", out).exit_code == 0
    out.write_text(filled(out.read_text()))
    (mount,) = read_any_calibration(out).calibration.mounts
    assert mount.frame_id == frame
