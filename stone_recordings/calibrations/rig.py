"""`stone_rig: 1`: a document that completes the files of another tool, in a bundle with them.

    stone_rig: 1
    name: warthog-1
    ego: base_link            # the ego frame, if names are ambiguous
    lidar: os_sensor          # the LiDAR's frame
    transforms:               # transforms that no other file has; parent_from_child
      - {parent: base_link, child: os_sensor, translation_m: [0, 0, 0.9], rotation_wxyz: [1, 0, 0, 0]}
    sensors:                  # the frame of each channel in the other files
      CAM_FRONT: {frame: cam0, frame_id: cam_front_optical, width_px: 1920, height_px: 1200}
    footprint: {length_m: 1.06, width_m: 0.85}
    vehicle: {max_slope_deg: 20, max_step_m: 0.12, height_m: 1.6}

**Conventions.** As in the native format. A sensor named here belongs to the calibration even if its frame's name
reveals nothing; other sensors stay, under the channel that their frame's name gives.
"""

from pydantic import ValidationError

from stone.sensors.calibration import SensorKind
from stone.sensors.calibration_checks import Findings
from stone_recordings.calibrations.native import RigDocument, key_error, transform_of
from stone_recordings.calibrations.part import CalibrationPart, Edge, Node


def is_rig(content: dict[str, object]) -> bool:
    return "stone_rig" in content


def rig_document(document: Node) -> RigDocument:
    """Read the document. Raises `CAL-422`."""
    try:
        return RigDocument.model_validate(document.value)
    except ValidationError as error:
        raise key_error(document.file, error) from None


def rig_part(file: str, rig: RigDocument) -> CalibrationPart:
    """Return the transforms and kinds that the rig adds."""
    edges, findings = list[Edge](), Findings()
    for given in rig.transforms:
        transform, noticed = transform_of(given.child, None, given)
        edges.append(Edge(given.parent, given.child, transform))
        findings += noticed
    kinds: dict[str, SensorKind] = {sensor.frame: sensor.kind for sensor in rig.sensors.values() if sensor.kind}
    return CalibrationPart(file, None, tuple(edges), kinds=kinds, findings=findings)
