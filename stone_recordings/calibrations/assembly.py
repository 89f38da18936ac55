"""A calibration from the parts of a bundle: the LiDAR's frame, the ego frame, and the frames of sensors.

**Conventions.** If two frames fit, neither is chosen: a rig document (`stone_rig: 1`) decides. If several frames can be
the ego frame, it is the one on the ground. A camera frame that is not known to be optical is judged by its rotation. A
link (x forward, z up) is turned to its optical frame, and a finding reports it.
"""

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import PurePath

import numpy as np

from stone.errors import Refused
from stone.findings import Finding
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, CameraIntrinsics, Mount, SensorKind
from stone.sensors.calibration_checks import Findings, check_intrinsics, check_translation, warning
from stone_recordings.calibrations.draft import EGO_FRAMES, RigDraft, channel_of, is_optical, words_of
from stone_recordings.calibrations.errors import bad_calibration_key, half_rig
from stone_recordings.calibrations.native import RigDocument, RigSensor, boxes_of, footprint_of, vehicle_of

ADD_RIG = "send it in a zip with a rig.yaml (`stone_rig: 1`)"
# x forward, y left, z up ← z forward, x right, y down (REP 103).
LINK_FROM_OPTICAL = SE3.from_parts(np.array([0.5, -0.5, 0.5, -0.5]), np.zeros(3))
UPRIGHT_LEAST = 0.5
KINDS: tuple[SensorKind, ...] = ("camera", "radar", "ins", "imu", "lidar")


def assembled(draft: RigDraft, rig: RigDocument) -> tuple[Calibration, Findings]:
    """Assemble the calibration. Raises `CAL-424`, `CAL-425`, `CAL-405`, `CAL-422`, and the errors of the checks."""
    _check_kits(draft)
    lidar = _lidar(draft, rig)
    ego = _ego(draft, rig, lidar)
    ego_from_lidar = draft.tree.transform(ego, lidar)
    if ego_from_lidar is None:
        raise disconnected_sensor("ego_from_lidar", ego, lidar)
    findings = check_translation("ego_from_lidar", ego_from_lidar.translation_m)
    mounts = list[Mount]()
    for channel, frame, sensor in _sensors(draft, rig, lidar):
        taken = {mount.name for mount in mounts}
        mount, noticed = _mount(draft, (lidar, ego_from_lidar), (frame if channel in taken else channel, frame), sensor)
        mounts.append(mount)
        findings += noticed
    boxes, footprint = boxes_of(rig.self_boxes_ego), footprint_of(rig.footprint)
    name = rig.name or PurePath(draft.name).stem[:100] or "calibration"
    return Calibration(name, ego_from_lidar, tuple(mounts), footprint, boxes, vehicle_of(rig.vehicle)), findings


def _check_kits(draft: RigDraft) -> None:
    """Raise `CAL-424` if a sensor kit is placed on the robot and its own sensors are missing."""
    parents = {parent for parent, _ in draft.tree.down}
    for frame in draft.frames:
        if "kit" in words_of(frame) and frame not in parents:
            missing = f"it has the transform to {frame}, but none to the sensors on it"
            raise half_rig(draft.name, missing, "send sensor_kit_calibration.yaml along in a zip")


def _lidar(draft: RigDraft, rig: RigDocument) -> str:
    if rig.lidar is not None:
        return _known(draft, "lidar", rig.lidar)
    lidars = draft.sensors_of("lidar")
    if len(lidars) > 1:
        raise ambiguous_rig(draft.name, "the LiDAR", lidars, f"{ADD_RIG} that has `lidar: {lidars[0]}`, say")
    if lidars:
        return lidars[0]
    if not draft.frames and not draft.lenses:
        raise half_rig(draft.name, "it has no extrinsics (only an IMU's noise model?)", "send the camchain with it")
    placed = ", ".join(list(dict.fromkeys((*draft.lenses, *draft.frames)))[:6])
    missing = f"it has extrinsics of {placed}, but no LiDAR" if draft.frames else f"it has {placed} without extrinsics"
    raise half_rig(draft.name, missing, f"{ADD_RIG} whose transforms place the LiDAR relative to one of them")


def _ego(draft: RigDraft, rig: RigDocument, lidar: str) -> str:
    if rig.ego is not None:
        return _known(draft, "ego", rig.ego)
    for frame in EGO_FRAMES:
        if frame in draft.frames and draft.tree.transform(frame, lidar) is not None:
            return frame
    missing = f"no transform places {lidar} on the robot (no frame is {', '.join(EGO_FRAMES)})"
    has_kit = any("kit" in words_of(frame) for frame in draft.frames)
    others = "send Autoware's sensors_calibration.yaml too, or " if has_kit else "send "
    remedy = f"{others}the robot's tf_static, or a rig.yaml whose transforms place {lidar} on base_link, in a zip"
    raise half_rig(draft.name, missing, remedy)


def _known(draft: RigDraft, key: str, frame: str) -> str:
    if frame not in draft.frames:
        known = ", ".join(draft.frames[:8])
        raise bad_calibration_key(
            draft.name, f"rig {key}", f"no transform names the frame {frame!r}; there are {known}", 0
        )
    return frame


def _sensors(draft: RigDraft, rig: RigDocument, lidar: str) -> list[tuple[str, str, RigSensor | None]]:
    """Return (channel, frame, entry in the rig document) of every sensor but the LiDAR, cameras first."""
    named = {draft.frame_of_lens(sensor.frame): (channel, sensor) for channel, sensor in rig.sensors.items()}
    lensed = [draft.frame_of_lens(lens) for lens in draft.lenses]
    others = [frame for kind in KINDS for frame in draft.sensors_of(kind)]
    sensors = list[tuple[str, str, RigSensor | None]]()
    for frame in dict.fromkeys((*named, *lensed, *others)):
        if frame in named:
            sensors.append((named[frame][0], frame, named[frame][1]))
        elif frame != lidar:
            sensors.append((channel_of(frame, _kind(draft, frame)), frame, None))
    return sensors


def _kind(draft: RigDraft, frame: str) -> SensorKind:
    kind = draft.kind(frame)
    return kind if kind is not None else "camera"


def _mount(
    draft: RigDraft, lidar: tuple[str, SE3], called: tuple[str, str], sensor: RigSensor | None
) -> tuple[Mount, Findings]:
    (lidar_frame, ego_from_lidar), (channel, frame) = lidar, called
    lidar_from_sensor = draft.tree.transform(lidar_frame, frame)
    if lidar_from_sensor is None:
        raise disconnected_sensor(channel, frame, lidar_frame)
    mount = Mount(channel, _kind(draft, frame), lidar_from_sensor, frame, _offset_ns(draft, frame, sensor))
    findings = check_translation(channel, lidar_from_sensor.translation_m)
    if mount.kind == "camera":
        if frame not in draft.optical and not is_optical(frame):
            mount, noticed = as_optical(mount, ego_from_lidar @ lidar_from_sensor)
            findings += noticed
        intrinsics, noticed = _lens(draft, frame, (channel, sensor))
        mount, findings = replace(mount, intrinsics=intrinsics), findings + noticed
    if sensor is not None and sensor.frame_id is not None:
        mount = replace(mount, frame_id=sensor.frame_id)
    return mount, findings


def _offset_ns(draft: RigDraft, frame: str, sensor: RigSensor | None) -> int:
    if sensor is not None and sensor.time_offset_ns is not None:
        return sensor.time_offset_ns
    return draft.offsets_ns.get(frame, 0)


def as_optical(mount: Mount, ego_from_frame: SE3) -> tuple[Mount, Findings]:
    """Return the mount of a camera in its optical frame, judged by its rotation, and a finding about it."""
    turn = ego_from_frame.rotation()
    upas_optical, up_as_link = (turn @ (0.0, -1.0, 0.0))[2], (turn @ (0.0, 0.0, 1.0))[2]
    if upas_optical >= UPRIGHT_LEAST:
        return mount, ()
    if up_as_link < UPRIGHT_LEAST:
        sentence = f"neither as a link nor as an optical frame is {mount.frame_id!r} upright; it is taken as optical"
        return mount, (warning("CAL-430", mount.name, sentence),)
    sentence = f"{mount.name}: {mount.frame_id!r} is a link (z up); the optical frame is turned from it as in REP 103"
    frame_id = re.sub(r"_?link$", "", mount.frame_id) + "_optical_link"
    turned = replace(mount, lidar_from_sensor=mount.lidar_from_sensor @ LINK_FROM_OPTICAL, frame_id=frame_id)
    return turned, (Finding("CAL-430", "info", mount.name, sentence),)


def _lens(draft: RigDraft, frame: str, of: tuple[str, RigSensor | None]) -> tuple[CameraIntrinsics | None, Findings]:
    channel, sensor = of
    lens = next((candidate for name, candidate in draft.lenses.items() if draft.frame_of_lens(name) == frame), None)
    if lens is None:
        sentence = f"{channel}: no file has its intrinsics (camera_info); points are not projected into its images"
        return None, (Finding("CAL-426", "info", channel, sentence),)
    if sensor is not None and sensor.width_px is not None and sensor.height_px is not None and not lens.width_px:
        lens = replace(lens, width_px=sensor.width_px, height_px=sensor.height_px)
    if not lens.width_px:
        return None, (warning("CAL-426", channel, "no file gives the size of its images; its intrinsics are not used"),)
    return lens, check_intrinsics(channel, lens)


def ambiguous_rig(name: str, what: str, choices: Iterable[str], remedy: str) -> Refused:
    shown = ", ".join(list(choices)[:8])
    return Refused("CAL-425", f"{name}: {what} could be any of {shown}; {remedy}")


def disconnected_sensor(sensor: str, frame: str, lidar_frame: str) -> Refused:
    return Refused(
        "CAL-405",
        f"{sensor}: its frame {frame!r} has no path to the LiDAR's frame {lidar_frame!r} "
        "(check for a missing transform, or two names of one frame)",
    )
