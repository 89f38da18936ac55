"""Every calibration file found in the wild is read as what it is, or refused with the code of what it misses."""

import shutil
from pathlib import Path

import pytest

from stone.errors import StoneError
from stone_recordings.calibrations.file import read_any_calibration

# A file alone. A Kalibr chain places cameras to an IMU, never a LiDAR: half a rig, completed by a rig.yaml beside it.
# A camera_info file says how a camera projects and not where it sits. Autoware's kit has three LiDARs and is not told
# which is meant; its sensors_calibration places a kit that is not there. KITTI's files know no ground under the car.
ALONE = {
    "autoware/sensor_kit_calibration.yaml": "CAL-425", "autoware/sensors_calibration.yaml": "CAL-424",
    "kalibr/camchain-imucam-euroc.yaml": "CAL-424", "kalibr/camchain-imucam-fla.yaml": "CAL-424",
    "kalibr/euroc_mav/kalibr_imu_chain.yaml": "CAL-424", "kalibr/euroc_mav/kalibr_imucam_chain.yaml": "CAL-424",
    "kalibr/kaist_vio/kalibr_imu_chain.yaml": "CAL-424", "kalibr/kaist_vio/kalibr_imucam_chain.yaml": "CAL-424",
    "kalibr/rpng_ironsides/kalibr_imu_chain.yaml": "CAL-424",
    "kalibr/rpng_ironsides/kalibr_imucam_chain.yaml": "CAL-424", "kalibr/rs_d455/kalibr_imu_chain.yaml": "CAL-424",
    "kalibr/rs_d455/kalibr_imucam_chain.yaml": "CAL-424", "kalibr/tum_vi/kalibr_imu_chain.yaml": "CAL-424",
    "kalibr/tum_vi/kalibr_imucam_chain.yaml": "CAL-424", "kitti/lidar/training/calib/00549.txt": "CAL-424",
    "kitti/radar/training/calib/00549.txt": "CAL-424", "nuscenes_like/calibrated_sensor.json": "CAL-424",
    "nuscenes_like/sensor.json": "CAL-423", "ros_camera_info/cameras/camera_front.yaml": "CAL-424",
    "ros_camera_info/cameras/camera_left.yaml": "CAL-424", "ros_camera_info/cameras/camera_rear.yaml": "CAL-424",
    "ros_camera_info/cameras/camera_right.yaml": "CAL-424",
    "ros_camera_info/transformations.yaml": "loads as ros_camera_info",
}  # fmt: skip
# A folder whole, with the rig document an engineer adds to it, if any. nuScenes' like says of no sensor where it sits:
# all are the identity, and it says so.
IMU_TO_LIDAR = """\
stone_rig: 1
transforms:
  - {parent: base_link, child: lidar, translation_m: [0, 0, 0.9], rotation_wxyz: [1, 0, 0, 0]}
  - {parent: lidar, child: imu0, translation_m: [0, 0, -0.1], rotation_wxyz: [1, 0, 0, 0]}
"""
UNDER_THE_CAR = """\
stone_rig: 1
transforms:
  - {parent: base_link, child: velodyne, translation_m: [0, 0, 1.7], rotation_wxyz: [1, 0, 0, 0]}
sensors: {CAM_FRONT: {frame: cam2, width_px: 1936, height_px: 1216}}
"""
TOGETHER = [
    ("ros_camera_info", "", "loads as ros_camera_info", ["CAL-401", "CAL-436"]),
    ("ros_camera_info/cameras", "", "CAL-424", []),
    ("autoware", "", "CAL-425", []),
    (
        "autoware",
        "stone_rig: 1\nlidar: velodyne_top_base_link\n",
        "loads as autoware",
        ["CAL-426", "CAL-430", "CAL-436"],
    ),
    ("nuscenes_like", "", "CAL-425", []),
    (
        "nuscenes_like",
        "stone_rig: 1\nlidar: LIDAR_FRONT\n",
        "loads as nuscenes",
        ["CAL-402", "CAL-417", "CAL-426", "CAL-436"],
    ),
    ("kalibr", "", "CAL-429", []),
    ("kalibr/euroc_mav", "", "CAL-424", []),
    ("kalibr/euroc_mav", IMU_TO_LIDAR, "loads as kalibr", ["CAL-436"]),
    ("kalibr/kaist_vio", IMU_TO_LIDAR, "loads as kalibr", ["CAL-436"]),
    ("kalibr/rpng_ironsides", IMU_TO_LIDAR, "loads as kalibr", ["CAL-436"]),
    ("kalibr/rs_d455", IMU_TO_LIDAR, "loads as kalibr", ["CAL-436"]),
    ("kalibr/tum_vi", IMU_TO_LIDAR, "loads as kalibr", ["CAL-436"]),
    ("kitti", "", "CAL-424", []),
    ("kitti", UNDER_THE_CAR, "loads as kitti", ["CAL-436"]),
]

pytestmark = pytest.mark.field_data


def outcome(path: Path) -> tuple[str, list[str]]:
    try:
        read = read_any_calibration(path)
    except StoneError as refused:
        return (refused.code if "\n" not in str(refused) and len(str(refused)) < 450 else f"rambles: {refused}"), []
    return f"loads as {read.format}", sorted({finding.code for finding in read.findings})


def test_the_table_names_every_file(field_data: Path) -> None:
    root = field_data / "calibrations"
    files = {file.relative_to(root).as_posix() for file in root.rglob("*") if file.is_file()}
    assert {name for name in files if not name.startswith(("LICENSE", "README"))} == set(ALONE)


@pytest.mark.parametrize("name", ALONE)
def test_a_file_alone(field_data: Path, name: str) -> None:
    assert outcome(field_data / "calibrations" / name)[0] == ALONE[name]


@pytest.mark.parametrize(("folder", "rig", "expected", "codes"), TOGETHER)
def test_a_folder_together(field_data, tmp_path, folder, rig, expected, codes):
    copy = tmp_path / "rig"
    shutil.copytree(field_data / "calibrations" / folder, copy)
    copy.chmod(0o755)
    if rig:
        (copy / "rig.yaml").write_text(rig)
    assert outcome(copy) == (expected, codes)


def test_the_four_cameras_of_a_real_rig_look_where_they_are_called(field_data: Path) -> None:
    found = read_any_calibration(field_data / "calibrations" / "ros_camera_info").calibration
    assert [mount.name for mount in found.of_kind("camera")] == ["CAM_FRONT", "CAM_LEFT", "CAM_BACK", "CAM_RIGHT"]
    ahead = {"CAM_FRONT": (1, 0), "CAM_LEFT": (0, 1), "CAM_BACK": (-1, 0), "CAM_RIGHT": (0, -1)}
    for name, direction in ahead.items():
        ego_from_camera = found.ego_from_lidar @ found.mount(name).lidar_from_sensor
        assert (ego_from_camera.rotation() @ (0, 0, 1))[:2] == pytest.approx(direction, abs=1e-3)
    assert found.ego_from_lidar.translation_m[2] == pytest.approx(0.408 + 0.068)
