"""ROS: camera_info files, CameraInfo messages as printed by `ros2 topic echo`, tf_static likewise, and T_a__b files.

**Conventions.** `camera_info` (camera_calibration's YAML) contains one camera's intrinsics and never its pose; its
`camera_name` serves as its frame. A TF transform, and `T_a__b`, are `a_from_b`. TF quaternions are written by key, so
their order is certain.
"""

import numpy as np

from stone.geometry.se3 import SE3
from stone.sensors.calibration_checks import Findings, check_translation, checked_norm, checked_transform
from stone_recordings.calibrations.part import CalibrationPart, Edge, LensText, Node, distortion_of, intrinsics

MATRIX_PREFIX, BETWEEN = "T_", "__"


def is_camera_info(content: dict[str, object]) -> bool:
    return "image_width" in content and "camera_matrix" in content


def camera_info(document: Node, stem: str) -> CalibrationPart:
    """Return the lens of one camera, named by its `camera_name`, else by the file (`stem`)."""
    name = document.at("camera_name").text() if document.has("camera_name") else stem
    size_px = (document.at("image_width").whole(), document.at("image_height").whole())
    matrix = document.at("camera_matrix").at("data").matrix(3, 3)
    distortion = distortion_of(document.at("distortion_coefficients").at("data"))
    text = LensText(document.file, name, _model(document), distortion)
    return CalibrationPart(document.file, "ros_camera_info", lenses={name: intrinsics(text, matrix, size_px)})


def is_camera_info_message(content: dict[str, object]) -> bool:
    return {"width", "height", "k", "d"} <= set(content)


def camera_info_message(document: Node, stem: str) -> CalibrationPart:
    """Return the lens from a message, named by its `header.frame_id`, which is the optical frame."""
    header = document.at("header") if document.has("header") else None
    name = header.at("frame_id").text().lstrip("/") if header is not None else stem
    text = LensText(document.file, name, _model(document), distortion_of(document.at("d")))
    lens = intrinsics(
        text, document.at("k").matrix(3, 3), (document.at("width").whole(), document.at("height").whole())
    )
    return CalibrationPart(document.file, "ros_camera_info", lenses={name: lens}, optical=frozenset({name}))


def _model(document: Node) -> str:
    return document.at("distortion_model").text() if document.has("distortion_model") else "plumb_bob"


def is_matrices(content: dict[str, object]) -> bool:
    return bool(content) and all(key.startswith(MATRIX_PREFIX) and BETWEEN in key for key in content)


def matrices(document: Node) -> CalibrationPart:
    """Return a part from `T_base_link__camera_front: {rows: 4, cols: 4, data: [...]}` for each pair of frames."""
    edges, findings = [], Findings()
    for key, node in document.entries().items():
        parent, _, child = key.removeprefix(MATRIX_PREFIX).partition(BETWEEN)
        matrix = (node.at("data") if node.has("data") else node).matrix(4, 4)
        transform, noticed = checked_transform(child, matrix)
        edges.append(Edge(parent, child, transform))
        findings += noticed
    return CalibrationPart(document.file, "ros_camera_info", tuple(edges), findings=findings)


def tf_message(documents: list[Node]) -> CalibrationPart:
    """Return all transforms of the messages; if a pair is published twice the last counts, as in tf2."""
    edges, findings = dict[tuple[str, str], Edge](), Findings()
    for document in documents:
        for stamped in document.at("transforms").items():
            parent = stamped.at("header").at("frame_id").text().lstrip("/")
            child = stamped.at("child_frame_id").text().lstrip("/")
            transform, noticed = _transform(child, stamped.at("transform"))
            edges[(parent, child)] = Edge(parent, child, transform)
            findings += noticed
    return CalibrationPart(documents[0].file, "tf_static", tuple(edges.values()), findings=findings)


def _transform(child: str, node: Node) -> tuple[SE3, Findings]:
    translation_m = np.array([node.at("translation").at(axis).number() for axis in "xyz"])
    wxyz = np.array([node.at("rotation").at(axis).number() for axis in "wxyz"])
    findings = checked_norm(child, wxyz) + check_translation(child, translation_m)
    return SE3.from_parts(wxyz, translation_m), findings
