"""One small file of each calibration format, with its suffix."""

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

from fuzz.targets import ENDINGS
from simulator.pipeline import write_calibration
from simulator.sensors.rig import calibration

CAMERA_INFO = """\
image_width: 640
image_height: 400
camera_name: cam_front
camera_matrix: {rows: 3, cols: 3, data: [381.0, 0, 320.0, 0, 381.0, 200.0, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.1, 0.01, 0, 0, 0]}
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
projection_matrix: {rows: 3, cols: 4, data: [381.0, 0, 320.0, 0, 0, 381.0, 200.0, 0, 0, 0, 1, 0]}
"""
KALIBR = """\
cam0:
  camera_model: pinhole
  intrinsics: [458.6, 457.2, 367.2, 248.3]
  distortion_model: radtan
  distortion_coeffs: [-0.28, 0.07, 0.0001, 0.00002]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
  T_cam_imu: [[1, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
  timeshift_cam_imu: 0.001
cam1:
  camera_model: pinhole
  intrinsics: [457.5, 456.1, 379.9, 255.2]
  distortion_model: equidistant
  distortion_coeffs: [-0.28, 0.07, -0.0001, -0.00003]
  resolution: [752, 480]
  rostopic: /cam1/image_raw
  T_cn_cnm1: [[1, 0, 0, -0.11], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
"""
AUTOWARE = """\
sensor_kit_base_link:
  velodyne_top_base_link: {x: 0.0, y: 0.0, z: 0.0, roll: 0.0, pitch: 0.0, yaw: 1.575}
  camera0/camera_link: {x: 0.1, y: 0.03, z: -0.1, roll: -0.02, pitch: 0.01, yaw: -0.02}
"""
TF_STATIC = """\
transforms:
- header: {stamp: {sec: 0, nanosec: 0}, frame_id: base_link}
  child_frame_id: lidar
  transform: {translation: {x: 0.1, y: 0.0, z: 1.2}, rotation: {x: 0.0, y: 0.0, z: 0.0, w: 1.0}}
"""
OPENCALIB = """\
{"top_center_lidar-to-center_camera-extrinsic": {"sensor_name": "top_center_lidar",
 "target_sensor_name": "center_camera", "device_type": "relational", "param_type": "extrinsic",
 "param": {"time_lag": 0, "sensor_calib": {"rows": 4, "cols": 4, "type": 6, "continuous": true,
 "data": [[1, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}}}}
"""
NUSCENES = """\
[{"token": "a", "sensor_token": "b", "translation": [1.7, 0.0, 1.5], "rotation": [0.5, -0.5, 0.5, -0.5],
  "camera_intrinsic": [[1266.4, 0.0, 816.2], [0.0, 1266.4, 491.5], [0.0, 0.0, 1.0]]},
 {"token": "c", "sensor_token": "d", "translation": [0.9, 0.0, 1.8], "rotation": [0.7, 0.0, 0.0, -0.7],
  "camera_intrinsic": []}]
"""
KITTI = """\
P2: 7.215377e+02 0 6.095593e+02 4.485728e+01 0 7.215377e+02 1.728540e+02 2.163791e-01 0 0 1 2.745884e-03
R0_rect: 1 0 0 0 1 0 0 0 1
Tr_velo_to_cam: 0 -1 0 -0.004 0 0 -1 -0.076 1 0 0 -0.271
Tr_imu_to_velo:
"""
KITTI_RAW = """\
calib_time: 15-Mar-2012 11:37:16
R: 0 -1 0 0 0 -1 1 0 0
T: -4.069766e-03 -7.631618e-02 -2.717806e-01
delta_f: 0.000000e+00 0.000000e+00
"""
RELLIS = """\
os1_cloud_node-pylon_camera_node:
  q: {w: -0.5, x: 0.5, y: 0.5, z: -0.5}
  t: {x: -0.13, y: 0.03, z: -0.17}
"""
RELLIS_LENS = "2813.643275 2808.326079 969.285772 624.049972\n"
OPENCV = """\
%YAML:1.0
---
image_width: 640
image_height: 400
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 381., 0., 320., 0., 381., 200., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -0.1, 0.01, 0., 0., 0. ]
R: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 0., -1., 0., 0., 0., -1., 1., 0., 0. ]
T: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ 0.1, -0.2, -0.3 ]
"""
VISUAL_LIDAR = """\
{"camera": {"camera_model": "plumb_bob", "distortion_coeffs": [-0.04, 0.08, 0.0001, -0.0003, -0.04],
  "intrinsics": [810.4, 810.3, 822.8, 622.5]}, "meta": {"data_path": "x"},
 "results": {"T_lidar_camera": [0.03, 0.002, 0.108, -0.5, 0.5, -0.5, 0.5],
  "init_T_lidar_camera": [0, 0, 0, 0, 0, 0, 1]}}
"""
FAST_LIVO2 = """\
/**:
  ros__parameters:
    common: {img_topic: /image, lid_topic: /livox/lidar}
    extrin_calib:
      extrinsic_T: [0.04, 0.02, -0.03]
      extrinsic_R: [1, 0, 0, 0, 1, 0, 0, 0, 1]
      Rcl: [0, -1, 0, 0, 0, -1, 1, 0, 0]
      Pcl: [0.02, 0.1, -0.03]
"""
FAST_LIVO2_LENS = """\
cam_model: Pinhole
cam_width: 1280
cam_height: 1024
scale: 0.5
cam_fx: 1293.5
cam_fy: 1293.3
cam_cx: 626.9
cam_cy: 522.8
cam_d0: -0.076
cam_d1: 0.123
cam_d2: -0.001
cam_d3: 0.0002
"""
LIO_SAM = """\
lio_sam:
  extrinsicTrans: [-0.8, 0.3, -0.8]
  extrinsicRot: [-1, 0, 0, 0, 1, 0, 0, 0, -1]
  extrinsicRPY: [0, -1, 0, 1, 0, 0, 0, 0, 1]
"""
URDF = """\
<?xml version="1.0"?><robot name="r"><link name="base_link"/><link name="lidar"/>
<joint name="a" type="fixed">
<origin xyz="0.1 0 0.9" rpy="0 0.1 1.57"/><parent link="base_link"/><child link="lidar"/></joint>
<joint name="b" type="revolute"><parent link="lidar"/><child link="camera"/></joint></robot>
"""
TEXTS = {
    "visual-lidar": (".json", VISUAL_LIDAR),
    "fast-livo2": (".yaml", FAST_LIVO2),
    "fast-livo2-lens": (".yaml", FAST_LIVO2_LENS),
    "lio-sam": (".yaml", LIO_SAM),
    "urdf": (".urdf", URDF),
    "kitti": (".txt", KITTI),
    "kitti-raw": (".txt", KITTI_RAW),
    "rellis": (".yaml", RELLIS),
    "rellis-lens": (".txt", RELLIS_LENS),
    "opencv": (".yaml", OPENCV),
    "camera-info": (".yaml", CAMERA_INFO),
    "kalibr": (".yaml", KALIBR),
    "autoware": (".yaml", AUTOWARE),
    "tf-static": (".yaml", TF_STATIC),
    "opencalib": (".json", OPENCALIB),
    "nuscenes": (".json", NUSCENES),
}


def calibrations() -> Mapping[str, tuple[int, bytes]]:
    """Return the index of the suffix and the file, by name."""
    files = {name: (ENDINGS.index(ending), text.encode()) for name, (ending, text) in TEXTS.items()}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "rig.yaml"
        write_calibration(calibration(640), path)
        files["native"] = (ENDINGS.index(".yaml"), path.read_bytes())
    return files
