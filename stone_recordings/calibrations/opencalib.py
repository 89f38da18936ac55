"""OpenCalib (SensorsCalibration): JSON of `<sensor>-to-<target>-extrinsic` and `<camera>-intrinsic` entries.

**Conventions.** `sensor_calib` maps coordinates of the sensor to those of the target: `target_from_sensor`. Cameras are
optical. `time_lag`, seconds, is accepted as 0 only: no document defines its clock. Their own samples contradict
themselves (`cols: 4` over five coefficients), so rows and columns are compared with the data.
"""

from stone.sensors.calibration import CameraIntrinsics, SensorKind
from stone.sensors.calibration_checks import Findings, checked_transform, warning
from stone_recordings.calibrations.draft import kind_of
from stone_recordings.calibrations.part import CalibrationPart, Edge, LensText, Node, distortion_of, intrinsics


def is_opencalib(content: dict[str, object]) -> bool:
    return bool(content) and all(isinstance(value, dict) and "sensor_name" in value for value in content.values())


def opencalib(document: Node) -> CalibrationPart:
    """Return the extrinsics and intrinsics of one file; other kinds of parameters (homographies, heading) are
    ignored.
    """
    edges, findings = list[Edge](), Findings()
    lenses, kinds = dict[str, CameraIntrinsics](), dict[str, SensorKind]()
    for node in document.entries().values():
        name, kind = node.at("sensor_name").text(), node.at("param_type").text()
        if kind == "extrinsic":
            edge, noticed = _edge(name, node)
            edges.append(edge)
            findings += noticed
            named = {frame: kind_of(frame) for frame in (edge.parent, edge.child)}
            kinds |= {frame: sensor_kind for frame, sensor_kind in named.items() if sensor_kind is not None}
        elif kind == "intrinsic" and node.at("param").has("cam_K"):
            lenses[name] = _lens(name, node.at("param"))
    optical = frozenset(lenses) | {frame for frame, kind in kinds.items() if kind == "camera"}
    return CalibrationPart(document.file, "opencalib", tuple(edges), lenses, {}, kinds, optical, findings)


def _edge(name: str, node: Node) -> tuple[Edge, Findings]:
    target, parameters = node.at("target_sensor_name").text(), node.at("param")
    transform, findings = checked_transform(name, _sized(parameters.at("sensor_calib")).matrix(4, 4))
    if parameters.has("time_lag") and (lag_s := parameters.at("time_lag").number()) != 0:
        sentence = f"time_lag {lag_s:g} is not applied: the format does not define its clock (set time_offset_ns)"
        findings += (warning("CAL-432", name, sentence),)
    return Edge(target, name, transform), findings


def _lens(name: str, parameters: Node) -> CameraIntrinsics:
    distortion = distortion_of(_sized(parameters.at("cam_dist")))
    size_px = (parameters.at("img_dist_w").whole(), parameters.at("img_dist_h").whole())
    model = "radtan" if len(distortion) == 4 else "plumb_bob"
    text = LensText(parameters.file, name, model, distortion)
    return intrinsics(text, _sized(parameters.at("cam_K")).matrix(3, 3), size_px)


def _sized(matrix: Node) -> Node:
    """Return the data of a matrix with consistent rows and columns."""
    data = matrix.at("data")
    rows = data.items()
    declared = (matrix.at("rows").whole("rows"), matrix.at("cols").whole("columns"))
    given = (len(rows), len(rows[0].items()) if rows else 0)
    if declared != given:
        problem = f"{declared[0]} x {declared[1]} numbers are declared and {given[0]} x {given[1]} given"
        raise data.refused(problem)
    return data
