"""Recognition of a document's format, and its content as a part of a rig.

**Conventions.** Keys that only one format has at its top level identify it, never a file's name. If a document
resembles a calibration in an unsupported format, the refusal names the format.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import PurePath

from stone.errors import Refused
from stone_files.calibration_bundle import Bundle
from stone_recordings.calibrations import (
    autoware,
    kalibr,
    kitti,
    nuscenes,
    odometry_parameters,
    opencalib,
    opencv,
    rellis,
    rig,
    ros,
    urdf,
    visual_lidar,
)
from stone_recordings.calibrations.errors import conflicting_files
from stone_recordings.calibrations.native import RigDocument, is_native
from stone_recordings.calibrations.part import CalibrationPart, Node
from stone_recordings.calibrations.plain_yaml import parse_documents

Mapping = dict[str, object]
# In the order of evaluation: a test of the format → the part. Formats with camera names receive the file's stem.
READERS: tuple[tuple[Callable[[Mapping], bool], Callable[[Node], CalibrationPart]], ...] = (
    (opencv.is_opencv, lambda node: opencv.opencv(node, stem_of(node.file))),
    (ros.is_camera_info, lambda node: ros.camera_info(node, stem_of(node.file))),
    (ros.is_camera_info_message, lambda node: ros.camera_info_message(node, stem_of(node.file))),
    (ros.is_matrices, ros.matrices),
    (visual_lidar.is_visual_lidar, visual_lidar.visual_lidar),
    (odometry_parameters.is_odometry, odometry_parameters.odometry),
    (odometry_parameters.is_odometry_camera, odometry_parameters.odometry_camera),
    (kalibr.is_camchain, kalibr.camchain),
    (kalibr.is_imu, lambda node: CalibrationPart(node.file, "kalibr")),
    (opencalib.is_opencalib, opencalib.opencalib),
    (autoware.is_autoware, autoware.autoware),
    (kitti.is_kitti, kitti.kitti),
    (rellis.is_rellis, rellis.rellis),
)
# A key that only one other format has at its top level.
OTHERS = {
    "camera_matrix": "a camera matrix without the size of its images",
    "image_width": "a camera_info file without its camera_matrix",
}


@dataclass(frozen=True, eq=False)
class RecognisedBundle:
    """`native` stands alone: its file and content; else the parts and the rig document that completes them."""

    native: tuple[str, object] | None
    parts: tuple[CalibrationPart, ...]
    rig: RigDocument


def recognised(bundle: Bundle, name: str) -> RecognisedBundle:
    """Return the recognised bundle. Raises the errors of YAML and formats; `CAL-429` for two complete calibrations."""
    robots = [(file, content) for file, content in bundle.documents if urdf.is_urdf(content)]
    texts = [(file, content) for file, content in bundle.documents if not urdf.is_urdf(content)]
    documents = [(file, parse_documents(file, content)) for file, content in texts]
    whole = [(file, parsed[0]) for file, parsed in documents if isinstance(parsed[0], dict) and is_native(parsed[0])]
    if whole:
        if len(bundle.documents) > 1:
            raise conflicting_files(
                name, "the rig, which a native file describes completely", [file for file, _ in bundle.documents]
            )
        return RecognisedBundle(whole[0], (), RigDocument(stone_rig=1))
    tables: dict[str, object] = {file: parsed[0] for file, parsed in documents if isinstance(parsed[0], list)}
    parts = [urdf.urdf(file, content) for file, content in robots]
    rigs = list[tuple[str, RigDocument]]()
    for file, parsed in documents:
        if file not in tables and isinstance(parsed[0], dict) and rig.is_rig(parsed[0]):
            rigs.append((file, rig.rig_document(Node(file, "", parsed[0]))))
        elif file not in tables:
            parts.append(_part(file, parsed))
    parts += _tables(tables)
    if len(rigs) > 1:
        raise conflicting_files(name, "the rest of the rig", [file for file, _ in rigs])
    parts += [rig.rig_part(file, document) for file, document in rigs]
    return RecognisedBundle(None, tuple(parts), rigs[0][1] if rigs else RigDocument(stone_rig=1))


def stem_of(file: str) -> str:
    return PurePath(file).stem[:100]


def _part(file: str, documents: tuple[object, ...]) -> CalibrationPart:
    content = documents[0]
    if rellis.is_camera_text(content):
        return rellis.camera_text(Node(file, "", content))
    if not isinstance(content, dict):
        raise unknown_calibration_format(file, "an empty file" if content is None else "plain text")
    if any(not isinstance(key, str) for key in content):
        raise unknown_calibration_format(file, "another YAML file (a key is not text)")
    if "transforms" in content:
        return ros.tf_message([Node(file, "", document) for document in documents])
    for is_it, read in READERS:
        if is_it(content):
            return read(Node(file, "", content))
    looks_like = next((named for key, named in OTHERS.items() if key in content), "another YAML file")
    raise unknown_calibration_format(file, looks_like)


def _tables(tables: dict[str, object]) -> list[CalibrationPart]:
    """Return the nuScenes tables among lists; any other list is refused."""
    rows = {file: content for file, content in tables.items() if isinstance(content, list)}
    calibrated = [file for file, content in rows.items() if nuscenes.is_calibrated(content)]
    sensors = [file for file, content in rows.items() if nuscenes.is_sensors(content)]
    for file in rows:
        if file not in calibrated and (file not in sensors or not calibrated):
            looks_like = "a nuScenes sensor table without its calibrated_sensor" if file in sensors else "a list"
            raise unknown_calibration_format(file, looks_like)
    named = Node(sensors[0], "", rows[sensors[0]]) if sensors else None
    return [nuscenes.nuscenes(Node(file, "", rows[file]), named) for file in calibrated]


def unknown_calibration_format(name: str, looks_like: str) -> Refused:
    return Refused(
        "CAL-423",
        f"{name} looks like {looks_like}; read are the native format (`stone_calibration: 1`, see examples/), ROS "
        "camera_info, Kalibr camchain, OpenCalib, nuScenes calibrated_sensor, Autoware sensor_kit, KITTI calib, "
        "RELLIS-3D transforms, OpenCV matrices, direct_visual_lidar_calibration's calib.json, parameters of FAST-LIO, "
        "FAST-LIVO2 and LIO-SAM, URDF and /tf_static",
    )
