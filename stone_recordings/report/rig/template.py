"""A native calibration with everything that a recording reveals about its robot, to be completed by hand.

**Conventions.** Extrinsics are those of /tf_static, lenses those of CameraInfo, sizes those of the first picture. An
unknown value is FILL_IN, which reading refuses by name (`CAL-453`), with a comment on what to measure.
"""

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from stone.errors import StoneError
from stone.geometry.se3 import SE3
from stone.sensors.calibration import CameraIntrinsics, Mount, SensorKind
from stone_recordings.bags.bag import Bag
from stone_recordings.calibrations.assembly import as_optical
from stone_recordings.calibrations.draft import EGO_FRAMES, RigDraft, channel_of, draft_of, is_optical
from stone_recordings.calibrations.native import FILL_IN, filled_in
from stone_recordings.calibrations.plain_yaml import parse_documents
from stone_recordings.calibrations.recording_rig import recorded_facts
from stone_recordings.messages.camera import decode_image
from stone_recordings.report.inspection import Inspection, frame_id_of, inspect_in
from stone_recordings.topics.profiles import TopicProfile
from stone_recordings.topics.roles import Role

PLACED: tuple[Role, ...] = ("camera", "radar", "imu", "ins")
MOST_SENSORS = 64


@dataclass(frozen=True)
class CalibrationTemplate:
    """The YAML, the keys whose values are FILL_IN, and the channels whose values are complete."""

    text: str
    missing: tuple[str, ...]
    known: tuple[str, ...]


@dataclass(frozen=True)
class _Sensor:
    """A topic of a sensor; its pose on the LiDAR and its lens, None if no topic gives them."""

    channel: str
    kind: SensorKind
    topic: str
    frame_id: str
    lidar_from_sensor: SE3 | None
    lens: CameraIntrinsics | None = None
    size_px: tuple[int, int] | None = None


def calibration_template(bag: Bag, name: str, profile: TopicProfile | None = None) -> CalibrationTemplate:
    """Return the template of a recording's robot. Raises the errors of inspecting (BAG-*)."""
    inspection = inspect_in(bag, profile)
    draft = draft_of(name, (recorded_facts(bag),))
    lidar_topic = inspection.assignment.channels.get("lidar", "")
    lidar = next((frame_id_of(bag, item.topic) for item in inspection.topics if item.topic.name == lidar_topic), "")
    ego = next((frame for frame in EGO_FRAMES if draft.tree.transform(frame, lidar) is not None), None)
    sensors = list(_sensors(bag, inspection, (draft, lidar, ego)))
    text = "\n".join(_lines(name, (lidar_topic, lidar), (ego, draft), sensors)) + "\n"
    missing = filled_in(parse_documents(name, text.encode())[0])
    known = [sensor.channel for sensor in sensors if not any(f"sensors.{sensor.channel}." in key for key in missing)]
    return CalibrationTemplate(text, missing, tuple(known))


def _sensors(bag: Bag, inspection: Inspection, of: tuple[RigDraft, str, str | None]) -> Iterator[_Sensor]:
    draft, lidar, ego = of
    parts = {topic: part for part, topic in inspection.assignment.channels.items()}
    taken, seen = set[str](), set[tuple[str, str]]()
    sensors = [sensor for sensor in inspection.topics if sensor.role in PLACED and sensor.topic.count]
    for sensor in sorted(sensors, key=lambda sensor: PLACED.index(sensor.role or "camera"))[:MOST_SENSORS]:
        kind: SensorKind = sensor.role  # type: ignore[assignment]
        frame = frame_id_of(bag, sensor.topic)
        words = frame or sensor.topic.name.strip("/").replace("/", "_") or kind
        channel = parts.get(sensor.topic.name, "")
        channel = channel if channel and channel not in ("pose", "imu", "ins") else channel_of(words, kind)
        channel = (words if channel in taken else channel)[:100]
        if channel in taken or (kind, frame) in seen:  # a second topic of the same sensor
            continue
        taken.add(channel)
        seen |= {(kind, frame)} if frame else set()
        lidar_from_sensor = draft.tree.transform(lidar, frame) if frame else None
        size_px = _size_px(bag, sensor.topic.name, sensor.topic.type) if kind == "camera" else None
        lens = draft.lenses.get(frame)
        if lidar_from_sensor is not None and kind == "camera" and frame not in draft.optical and not is_optical(frame):
            ego_from_lidar = (draft.tree.transform(ego, lidar) if ego else None) or SE3.identity()
            mount, _ = as_optical(Mount(channel, kind, lidar_from_sensor, frame), ego_from_lidar @ lidar_from_sensor)
            lidar_from_sensor = mount.lidar_from_sensor
        yield _Sensor(channel, kind, sensor.topic.name, frame, lidar_from_sensor, lens, size_px)


def _size_px(bag: Bag, topic: str, type_name: str) -> tuple[int, int] | None:
    """Return the size of the first picture, None if it cannot be read."""
    try:
        picture = decode_image(bag.message(topic, 0).payload, type_name)
    except StoneError:
        return None
    return (picture.width_px, picture.height_px) if picture.width_px and picture.height_px else None


def _lines(
    name: str, lidar: tuple[str, str], ego: tuple[str | None, RigDraft], sensors: Iterable[_Sensor]
) -> Iterator[str]:
    (topic, frame), (ego_frame, draft) = lidar, ego
    yield f"# Written by `stone calibration init`. Measure each value that is {FILL_IN} and write it in its place."
    yield "# Lengths are metres; x is forward, y left, z up; quaternions are w x y z; ego lies on the ground."
    yield "stone_calibration: 1"
    yield f"name: {_text(name)}"
    yield f"footprint: {{length_m: {FILL_IN}, width_m: {FILL_IN}}}  # of the ground that wheels or tracks cover"
    pose = draft.tree.transform(ego_frame, frame) if ego_frame else None
    source = f"{_text(ego_frame)} from {_text(frame)} of /tf_static; its height is over {_text(ego_frame)}"
    if pose is None:
        source = "the LiDAR's pose on the robot; /tf_static does not contain it"
    yield f"ego_from_lidar:  # of {_text(topic)}: {source}"
    yield from _pose("  ", pose)
    yield "sensors:" + ("" if (held := list(sensors)) else " {}")
    for sensor in held:
        yield f"  {_text(sensor.channel)}:  # {_text(sensor.topic)}"
        yield f"    kind: {sensor.kind}"
        yield f"    frame_id: {_text(sensor.frame_id)}"
        yield "    lidar_from_sensor:" + ("" if sensor.lidar_from_sensor else "  # no /tf_static places it")
        yield from _pose("      ", sensor.lidar_from_sensor)
        if sensor.kind == "camera":
            yield from _lens(sensor)


def _pose(indent: str, pose: SE3 | None) -> Iterator[str]:
    translation = [FILL_IN] * 3 if pose is None else [_number(value) for value in pose.translation_m.tolist()]
    turn = [FILL_IN] * 4 if pose is None else [_number(value) for value in pose.wxyz.tolist()]
    yield f"{indent}translation_m: [{', '.join(translation)}]"
    yield f"{indent}rotation_wxyz: [{', '.join(turn)}]"


def _lens(sensor: _Sensor) -> Iterator[str]:
    lens = sensor.lens
    if lens is not None:
        width, height, model = str(lens.width_px), str(lens.height_px), str(lens.model)
        numbers = [_number(length) for length in (lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px)]
        distortion = ", ".join(map(_number, lens.distortion))
        yield "    intrinsics:"
    else:
        width, height = map(str, sensor.size_px or (FILL_IN, FILL_IN))
        numbers, distortion, model = [FILL_IN] * 4, "", "pinhole"
        yield "    intrinsics:  # no CameraInfo; leave out intrinsics if points need not be projected into its pictures"
    yield f"      model: {model}" + (
        "" if lens else "  # plumb_bob with 5 numbers in distortion, or equidistant with 4"
    )
    yield f"      width_px: {width}"
    yield f"      height_px: {height}"
    yield from (f"      {key}_px: {value}" for key, value in zip(("fx", "fy", "cx", "cy"), numbers, strict=True))
    yield f"      distortion: [{distortion}]"


def _number(value: float) -> str:
    """Return a float in a form that every YAML parser reads."""
    text = f"{value:.12g}"
    if "e" in text:
        return text if "." in text else text.replace("e", ".0e")
    return text if "." in text or not text.lstrip("-").isdigit() else f"{text}.0"


def _text(value: object) -> str:
    """Return a quoted text on one line; names of frames and topics are untrusted."""
    return json.dumps(str(value)[:100])


def template_name(path: Path) -> str:
    """Return the calibration's name, derived from the recording's."""
    return path.stem[:100] or "robot"
