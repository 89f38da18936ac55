"""URDF: a robot's links and the joints between them, whose origins are the extrinsics.

**Conventions.** A joint's `origin` is `parent_from_child` with the joint at zero, metres, and rpy about fixed axes: the
rotation is Rz(yaw) · Ry(pitch) · Rx(roll). Movable joints are read at zero, with a finding. Names of frames reveal
their sensors, as in tf_static. XML is hostile: no document type, no entities, bounded depth and number of joints.
Unexpanded xacro is refused with the command that expands it. Source: wiki.ros.org/urdf/XML/joint.
"""

from shlex import quote
from xml.parsers import expat

import numpy as np

from stone.errors import Refused
from stone.findings import Finding
from stone.sensors.calibration_checks import Findings, rotation_and_translation
from stone_recordings.calibrations.autoware import rotation_from_rpy
from stone_recordings.calibrations.errors import bad_calibration_key
from stone_recordings.calibrations.part import LONGEST_NAME, CalibrationPart, Edge, Node

DEEPEST, MOST_JOINTS, MOST_ELEMENTS = 32, 1000, 100_000
XACRO = ("${", "$(", "xacro:")
Attributes = dict[str, str]


def is_urdf(content: bytes) -> bool:
    return content.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] == b"<" and b"<robot" in content


def urdf(file: str, content: bytes) -> CalibrationPart:
    """Return the tree of links. Raises `CAL-450` (no XML, a document type, too deep), `CAL-451` (xacro), `CAL-422`."""
    joints = _joints(file, content)
    edges, findings, parents = list[Edge](), Findings(), dict[str, str]()
    movable = [joint["name"] for joint in joints if joint.get("type", "fixed") != "fixed"]
    for joint in joints:
        parent, child = (_link(file, joint, key) for key in ("parent", "child"))
        if parents.setdefault(child, joint["name"]) != joint["name"]:
            raise bad_calibration_key(file, f"joint {joint['name']}", f"the link {child!r} has two parents", 0)
        rpy, xyz = (_three(file, joint, key) for key in ("rpy", "xyz"))
        rotation = rotation_from_rpy(*rpy.tolist())
        parent_from_child, noticed = rotation_and_translation(child, rotation, xyz)
        edges.append(Edge(parent, child, parent_from_child))
        findings += noticed
    if movable:
        shown = ", ".join(movable[:5]) + (f" and {len(movable) - 5} more" if len(movable) > 5 else "")
        sentence = f"joints that move are read at zero: {shown}; place a sensor behind one by a rig.yaml"
        findings += (Finding("CAL-452", "info", "", sentence),)
    return CalibrationPart(file, "urdf", tuple(edges), findings=findings)


class _Reader:
    """Collects the joints of a robot in expat's callbacks; each with name, type, parent, child, xyz, rpy."""

    def __init__(self, file: str) -> None:
        self.file, self.joints, self.path, self.elements = file, list[Attributes](), list[str](), 0

    def start(self, name: str, attributes: Attributes) -> None:
        self.path.append(name)
        self.elements += 1
        self._refuse_xacro(name, attributes)
        if len(self.path) > DEEPEST or self.elements > MOST_ELEMENTS:
            raise bad_xml(self.file, f"it is deeper than {DEEPEST} levels or has more than {MOST_ELEMENTS} elements")
        if self.path == ["robot", "joint"]:
            if len(self.joints) == MOST_JOINTS:
                raise bad_xml(self.file, f"it has more than {MOST_JOINTS} joints")
            named = attributes.get("name", f"number {len(self.joints) + 1}")[:LONGEST_NAME]
            self.joints.append({"name": named, "type": attributes.get("type", "")[:LONGEST_NAME]})
        elif self.path[:2] == ["robot", "joint"] and len(self.path) == 3:
            keys = {"parent": ("link",), "child": ("link",), "origin": ("xyz", "rpy")}.get(name, ())
            self.joints[-1] |= {name if key == "link" else key: attributes[key] for key in keys if key in attributes}
        elif len(self.path) == 1 and name != "robot":
            raise bad_xml(self.file, f"it begins with <{name[:40]}>, a URDF with <robot>")

    def end(self, _name: str) -> None:
        self.path.pop()

    def refuse_type(self, *_about: object) -> None:
        raise bad_xml(self.file, "it has a document type or entities, which are not read")

    def _refuse_xacro(self, name: str, attributes: Attributes) -> None:
        if name.startswith(XACRO[-1]) or any(mark in value for value in attributes.values() for mark in XACRO[:2]):
            file, out = quote(self.file), "robot.urdf" if self.file != "robot.urdf" else "expanded.urdf"
            raise Refused(
                "CAL-451",
                f"{self.file} is not expanded (<{name[:40]}>): run `xacro {file} > {out}`, or with ROS 2 "
                f"`ros2 run xacro xacro {file} > {out}`, and send {out}",
            )


def _joints(file: str, content: bytes) -> list[Attributes]:
    reader, parser = _Reader(file), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = reader.start, reader.end
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = reader.refuse_type
    parser.ExternalEntityRefHandler = None
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise bad_xml(file, f"{expat.ErrorString(error.code)} on line {error.lineno}") from None
    except (ValueError, LookupError, UnicodeError) as error:  # an encoding with an unknown name
        raise bad_xml(file, str(error)[:80]) from None
    if not reader.joints:
        raise bad_xml(file, "it has no joint, so it places no sensor")
    return reader.joints


def _link(file: str, joint: Attributes, key: str) -> str:
    return Node(file, f"joint {joint['name']}.{key}", joint.get(key)).text().lstrip("/")


def _three(file: str, joint: Attributes, key: str) -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    words = Node(file, f"joint {joint['name']}.origin.{key}", joint.get(key, "0 0 0"))
    numbers = np.array([word.number() for word in words.words()])
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        raise words.refused("three numbers between spaces are expected")
    return numbers


def bad_xml(file: str, problem: str) -> Refused:
    return Refused("CAL-450", f"{file} is not a URDF: {problem}")
