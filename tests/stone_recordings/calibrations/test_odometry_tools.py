"""Calibrations of odometry packages and of robots' URDFs map points as their packages' own equations do."""

import json
from pathlib import Path
from textwrap import dedent

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stone.errors import StoneError
from stone_recordings.calibrations.file import CalibrationRead, read_any_calibration
from testing.refusals import refused_as

POINT = np.array([4.0, -1.5, 0.7])
RIG = """\
stone_rig: 1
transforms: [{parent: base_link, child: lidar, translation_m: [0.1, 0, 0.9], rotation_wxyz: [1, 0, 0, 0]}]
footprint: {length_m: 1.0, width_m: 0.8}
"""
SIZED = RIG + "sensors: {CAM: {frame: camera, width_px: 1640, height_px: 1240}}\n"
RCL = [[0.00610193, -0.999863, -0.0154172], [-0.00615449, 0.0153796, -0.999863], [0.999962, 0.00619598, -0.0060598]]
PCL = [0.0194384, 0.104689, -0.0251952]
ROT = Rotation.from_euler("zyx", [0.3, -0.2, 0.1]).as_matrix()
PLACE = [0.04165, 0.02326, -0.0284]


def read(folder: Path, **files: str) -> CalibrationRead:
    for name, text in files.items():
        stem, _, ending = name.rpartition("_")
        (folder / f"{stem}.{ending}").write_text(dedent(text))
    return read_any_calibration(folder)


def in_sensor(found: CalibrationRead, name: str) -> NDArray[np.float64]:
    """Where a LiDAR's point is in a sensor's frame."""
    mount = found.calibration.mount(name)
    assert mount is not None
    return np.asarray(mount.lidar_from_sensor.inverse() @ POINT[None])[0]


def flat(matrix: object) -> str:
    return str(np.asarray(matrix).ravel().tolist())


FAST_LIO = f"mapping: {{det_range: 100.0, extrinsic_T: {PLACE}, extrinsic_R: {flat(ROT)}}}\n"
FAST_LIVO2 = f"extrin_calib: {{extrinsic_T: {PLACE}, extrinsic_R: {flat(ROT)}, Rcl: {flat(RCL)}, Pcl: {PCL}}}\n"
LENS = "cam_model: Pinhole\ncam_width: 1280\ncam_height: 1024\nscale: 0.5\ncam_fx: 1293.5\ncam_fy: 1293.3\n"
LENS += "cam_cx: 626.9\ncam_cy: 522.8\ncam_d0: -0.076\ncam_d1: 0.123\ncam_d2: -0.00113\ncam_d3: 0.000251\n"
LIO_SAM = f"lio_sam:\n  sensor: ouster\n  extrinsicTrans: {PLACE}\n  extrinsicRot: {flat(ROT)}\n"
LIO_SAM += "  extrinsicRPY: [0, -1, 0, 1, 0, 0, 0, 0, 1]\n"
BARE = "".join(line.strip() + "\n" for line in LIO_SAM.splitlines()[1:])


def in_ros2(text: str) -> str:
    return "/**:\n  ros__parameters:\n" + "".join(f"    {line}\n" for line in text.splitlines())


def dotted(text: str) -> str:
    group, _, values = text.partition(": {")
    pairs = values.rstrip("}\n").replace("], ", "]\n").replace("0, e", "0\ne").splitlines()
    return in_ros2("\n".join(f"{group}.{pair}" for pair in pairs))


@pytest.mark.parametrize("text", [FAST_LIO, in_ros2(FAST_LIO), dotted(FAST_LIO)], ids=["ros1", "ros2", "dotted"])
def test_fast_lio_has_the_lidars_pose_in_the_imus_frame(text: str, tmp_path: Path) -> None:
    found = read(tmp_path, mid360_yaml=text, rig_yaml=RIG)
    assert found.format == "fast_lio"
    assert in_sensor(found, "IMU") == pytest.approx(ROT @ POINT + PLACE)


@pytest.mark.parametrize("wrapped", [str, in_ros2])
def test_fast_livo2_projects_as_its_equation(wrapped: type[str], tmp_path: Path) -> None:
    found = read(tmp_path, avia_yaml=wrapped(FAST_LIVO2), camera_pinhole_yaml=wrapped(LENS), rig_yaml=RIG)
    assert found.format == "fast_livo2"
    assert in_sensor(found, "camera") == pytest.approx(np.array(RCL) @ POINT + PCL, abs=1e-3)
    assert in_sensor(found, "IMU") == pytest.approx(ROT @ POINT + PLACE)
    lens = found.calibration.of_kind("camera")[0].intrinsics
    assert lens is not None
    assert (lens.width_px, lens.height_px, lens.fx_px, lens.model) == (1280, 1024, 1293.5, "plumb_bob")
    assert lens.distortion == (-0.076, 0.123, -0.00113, 0.000251, 0.0)


@pytest.mark.parametrize("text", [LIO_SAM, in_ros2(BARE), BARE], ids=["ros1", "ros2", "bare"])
def test_lio_sam_turns_what_the_imu_measures_into_the_lidars_axes(text: str, tmp_path: Path) -> None:
    found = read(tmp_path, params_yaml=text, rig_yaml=RIG)
    assert found.format == "lio_sam"
    imu = found.calibration.mount("IMU")
    assert imu is not None
    measured = np.array([0.1, 0.2, 9.8])
    assert imu.lidar_from_sensor.rotation() @ measured == pytest.approx(ROT @ measured)
    assert imu.lidar_from_sensor.translation_m == pytest.approx(PLACE)


CALIB = {
    "camera": {
        "camera_model": "plumb_bob",
        "distortion_coeffs": [-0.0408, 0.0823, 0.00015, -0.00029, -0.0395],
        "intrinsics": [810.38, 810.28, 822.84, 622.47],
    },
    "meta": {"data_path": "ouster_pinhole"},
    "results": {
        "T_lidar_camera": [0.02996, 0.00185, 0.10837, -0.5020970, 0.4925098, -0.5009468, 0.5043659],
        "init_T_lidar_camera": [0.2, 0.1, 0.1, 0.0, 0.0, 0.0, 1.0],
    },
}


def test_direct_visual_lidar_calibration_maps_camera_points_to_the_lidar(tmp_path: Path) -> None:
    found = read(tmp_path, calib_json=json.dumps(CALIB), rig_yaml=SIZED)
    assert found.format == "visual_lidar"
    x, y, z, *xyzw = CALIB["results"]["T_lidar_camera"]
    in_camera = Rotation.from_quat(xyzw).inv().apply(POINT - [x, y, z])
    assert in_sensor(found, "CAM") == pytest.approx(in_camera, abs=1e-5)
    assert in_camera[2] > 3.5, "it looks ahead"
    lens = found.calibration.of_kind("camera")[0].intrinsics
    assert lens is not None
    assert (lens.fx_px, lens.cy_px, lens.width_px) == (810.38, 622.47, 1640)


REFUSED = {
    "no ground": (json.dumps(CALIB), "", "CAL-424", "no transform places lidar on the robot"),
    "the initial guess alone": (
        json.dumps(CALIB | {"results": {"init_T_lidar_camera": [0, 0, 0, 0, 0, 0, 1]}}), RIG, "CAL-424", "calibrate"),
    "omnidirectional": (
        json.dumps(CALIB | {"camera": CALIB["camera"] | {"camera_model": "omnidir"}}), RIG, "CAL-427", "omnidir"),
    "six numbers": (
        json.dumps(CALIB | {"results": {"T_lidar_camera": [0, 0, 0, 0, 0, 1]}}), RIG, "CAL-422", "seven numbers"),
    "a mirrored rotation": (FAST_LIO.replace(flat(ROT), "[1, 0, 0, 0, 1, 0, 0, 0, -1]"), RIG, "CAL-408", "lidar"),
    "eight numbers": (FAST_LIO.replace(flat(ROT), "[1, 0, 0, 0, 1, 0, 0, 0]"), RIG, "CAL-422", "3 rows of 3"),
    "an IMU alone": (LIO_SAM, "", "CAL-424", "no transform places lidar on the robot"),
    "an atan lens": (LENS.replace("Pinhole", "ATAN"), RIG, "CAL-427", "ATAN"),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_what_is_missing_or_not_read_is_named(kind: str, tmp_path: Path) -> None:
    text, rig, code, sentence = REFUSED[kind]
    with refused_as(code, match=sentence):
        read(tmp_path, **{"tool_yaml": text} | ({"rig_yaml": rig} if rig else {}))


def joint(name: str, parent: str, child: str, origin: str = "", kind: str = "fixed") -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{origin}{ends}</joint>'


MAST = joint("mast", "base_link", "mast", '<origin xyz="0.1 0.2 0.5" rpy="0 0 1.2"/>')
TILT = joint("tilt", "mast", "velodyne", '<origin xyz="0 0 0.4" rpy="0.1 0.2 0"/>', "revolute")
CAM = joint("cam", "mast", "camera_link", '<origin xyz="0.2 0 0"/>')
OPTICAL = joint(
    "opt", "camera_link", "camera_optical_frame", '<origin rpy="-1.5707963267948966 0 -1.5707963267948966"/>'
)


def robot(*joints: str) -> str:
    links = "".join(f'<link name="{name}"/>' for name in ("base_link", "mast", "velodyne", "camera_link"))
    return f'<?xml version="1.0"?>\n<!-- r --><robot name="r">{links}{"".join(joints)}</robot>'


def test_a_urdf_is_composed_along_its_joints(tmp_path: Path) -> None:
    (tmp_path / "robot.urdf").write_text(robot(MAST, TILT, CAM, OPTICAL))
    found = read_any_calibration(tmp_path / "robot.urdf")
    turn = Rotation.from_euler("z", 1.2)
    tilt = Rotation.from_euler("y", 0.2) * Rotation.from_euler("x", 0.1)
    in_mast = np.add(tilt.apply(POINT), [0, 0, 0.4])
    in_ego = np.add(turn.apply(in_mast), [0.1, 0.2, 0.5])
    assert np.asarray(found.calibration.ego_from_lidar @ POINT[None])[0] == pytest.approx(in_ego)
    ahead = in_mast - [0.2, 0, 0]
    assert in_sensor(found, "camera_optical_frame") == pytest.approx([-ahead[1], -ahead[2], ahead[0]])
    (moved,) = [finding for finding in found.findings if finding.code == "CAL-452"]
    assert "tilt" in moved.message


def test_a_urdf_has_its_lenses_from_beside_it(tmp_path: Path) -> None:
    rig = "stone_rig: 1\nsensors: {CAM_FRONT: {frame: camera}}\n"
    still = "translation_m: [0, 0, 0], rotation_wxyz: [1, 0, 0, 0]"
    rig += f"transforms: [{{parent: camera_optical_frame, child: camera, {still}}}]\n"
    found = read(tmp_path, robot_urdf=robot(MAST, TILT, CAM, OPTICAL), camera_yaml=LENS, rig_yaml=rig)
    mount = found.calibration.mount("CAM_FRONT")
    assert mount is not None
    assert mount.intrinsics is not None


LAUGHS = '<?xml version="1.0"?><!DOCTYPE r [<!ENTITY a "lol"><!ENTITY b "&a;&a;&a;&a;">]><robot name="&b;"/>'
XML = {
    "xacro by a property": (robot(joint("a", "${prefix}base", "velodyne")), "CAL-451"),
    "xacro by an element": (robot('<xacro:sensor name="x"/>', MAST), "CAL-451"),
    "xacro of an argument": (robot(joint("a", "base_link", "$(arg lidar)")), "CAL-451"),
    "a billion laughs": (LAUGHS, "CAL-450"),
    "a file of the system": ('<!DOCTYPE r SYSTEM "file:///etc/passwd"><robot/>', "CAL-450"),
    "an encoding that nobody knows": ('<?xml version="1.0" encoding="klingon"?><robot/>', "CAL-450"),
    "cut off": (robot(MAST, TILT)[:-30], "CAL-450"),
    "depth": ("<robot>" + "<a>" * 10_000, "CAL-450"),
    "joints without end": (robot(*[joint(f"j{n}", "a", f"b{n}") for n in range(1001)]), "CAL-450"),
    "no joint": (robot(), "CAL-450"),
    "an SDF around it": ("<sdf version='1.6'><robot/></sdf>", "CAL-450"),
    "a joint of two numbers": (robot(joint("a", "base_link", "velodyne", '<origin xyz="1 2"/>')), "CAL-422"),
    "a joint without a child": (robot('<joint name="a" type="fixed"><parent link="b"/></joint>'), "CAL-422"),
    "a link of two parents": (robot(MAST, TILT, joint("again", "base_link", "velodyne")), "CAL-422"),
    "a joint to itself": (robot(joint("a", "velodyne", "velodyne")), "CAL-429"),
    "no number": (robot(joint("a", "base_link", "velodyne", '<origin xyz="nan 0 0"/>')), "CAL-422"),
}


@pytest.mark.parametrize("kind", XML)
def test_hostile_and_unexpanded_xml_is_refused_by_name(kind: str, tmp_path: Path) -> None:
    text, code = XML[kind]
    (tmp_path / "robot.urdf").write_text(text)
    with pytest.raises(StoneError) as refusal:
        read_any_calibration(tmp_path / "robot.urdf")
    assert refusal.value.code == code
    assert "robot.urdf" in str(refusal.value)
    if code == "CAL-451":
        assert "`xacro robot.urdf > expanded.urdf`" in str(refusal.value)
