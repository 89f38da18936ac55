"""The ego trajectory from the recording's sources: odometry or TF here, an INS in `ins_poses`.

**Conventions.** The result is `map_from_ego`; `map` is the source's own fixed frame. If a source reports the pose of
another frame, the mounts relate it to the ego frame: through the LiDAR if tf_static connects it to that frame. The
LiDAR's path is then the measured one, even if the source and the calibration disagree on the base.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone.sensors.calibration import Calibration
from stone.sensors.course import headings_along
from stone.sensors.pose_quality import SolutionQuality
from stone_recordings.messages.batch import StampedMessage, refused_finding
from stone_recordings.messages.odometry import TYPE as ODOMETRY
from stone_recordings.messages.odometry import decode_odometry, other_frames_finding
from stone_recordings.messages.problems import read_readable
from stone_recordings.messages.tf import TransformSamples, decode_transforms
from stone_recordings.poses.extrinsics import BASE_FRAMES, plain
from stone_recordings.poses.places import local_poses
from stone_recordings.poses.static_tree import StaticTree
from stone_recordings.sync.clock_offsets import ClockOffsets, shifted_finding
from stone_recordings.sync.errors import NoUsablePoseError, no_pose_source
from stone_recordings.sync.recorded_messages import in_order

FIXED_FRAMES = ("odom", "map", "world")


@dataclass(frozen=True, eq=False)
class PoseTrack:
    """The robot's poses, their `source` and its `topic`; `solution` is the quality of each pose if the source reports
    it.

    `is_smooth` means that the source filters its samples with a motion model (an INS). `inputs` are the hashes of files
    beside the recording from which the track was read. `map_origin_deg_m` is latitude, longitude, height of the map's
    origin if known. With `is_course` the heading is the course over ground.
    """

    trajectory: Trajectory
    source: str
    topic: str
    findings: tuple[Finding, ...] = ()
    map_origin_deg_m: tuple[float, float, float] | None = None
    solution: SolutionQuality | None = None
    is_smooth: bool = False
    inputs: Mapping[str, str] = field(default_factory=dict)
    is_course: bool = False


@dataclass(frozen=True, eq=False)
class RigMounts:
    """The mounts of calibration and tf_static, the frame of the sweeps, the clock offsets, and the findings.

    `posed_frame` is the frame of poses that name none; "" if unknown. `base_from_lidar` is the mount before ground auto
    moved the ego origin, None if it is the calibration's. With `is_course` a source's orientation is ignored: the
    heading is the course over ground.
    """

    calibration: Calibration
    tree: StaticTree
    lidar_frame: str
    clocks: ClockOffsets = field(default_factory=ClockOffsets)
    findings: tuple[Finding, ...] = ()
    posed_frame: str = ""
    base_from_lidar: SE3 | None = None
    is_course: bool = False


def along_course(source: str, place_m: NDArray[np.float64], child_from_ego: SE3) -> SE3:
    """Return the ego poses (N,) of a level robot that faces its course, from the positions (N, 3) of one of its frames.

    Raises `NoUsablePoseError` if it never drives.
    """
    heading = headings_along(place_m)
    if not np.isfinite(heading).all():
        raise NoUsablePoseError(source, len(place_m), "the track is too short to have a course")
    none = np.zeros(len(heading))
    wxyz = np.stack([np.cos(heading / 2), none, none, np.sin(heading / 2)], axis=-1)
    level = SE3.from_parts(wxyz, np.zeros(3))
    return SE3.from_parts(wxyz, place_m - level @ child_from_ego.inverse().translation_m)


def course_finding(topic: str) -> Finding:
    """Return SYN-531: the heading is the course."""
    sentence = (
        "its orientation is not used: the heading is the course over ground, roll and pitch are 0. This is right if "
        "the "
        "robot drives forward on nearly level ground, and wrong if it reverses, drives sideways or turns on the spot"
    )
    return Finding("SYN-531", "warning", topic, sentence)


def track_from_odometry(
    messages: Iterable[StampedMessage], topic: str, rig: RigMounts, type_name: str = ODOMETRY
) -> PoseTrack:
    """Return the track of a topic of one of POSE_PLACES. Raises NoUsablePoseError and the errors of
    `decode_odometry`.
    """
    samples, unread = read_readable(topic, messages, lambda some: decode_odometry(some, type_name))
    child = samples.child_frame_id if type_name == ODOMETRY else rig.posed_frame
    source = f"{topic} ({samples.frame_id} to {child or 'the robot'}, {type_name})"
    pair = (samples.frame_id, child)
    track = _track((source, topic), pair, (samples.stamps_ns, samples.parent_from_child), rig)
    strays = other_frames_finding(topic, samples)
    return _with_refused(track, samples.refused_ns, samples.reason, (*unread, *strays))


def track_from_tf(messages: Iterable[StampedMessage], topic: str, rig: RigMounts) -> PoseTrack:
    """Return the track of the robot's base, or of its LiDAR, in odom, map or world, in that order.

    Raises `SYN-502` if no such pair is published, and the errors of `decode_transforms`.
    """
    samples, unread = read_readable(topic, messages, decode_transforms)
    wanted = [(fixed, child) for fixed in FIXED_FRAMES for child in (*BASE_FRAMES, rig.lidar_frame)]
    pairs = {(plain(pair.parent), plain(pair.child)): pair for pair in samples}
    chosen: TransformSamples | None = next((pairs[pair] for pair in wanted if pair in pairs), None)
    if chosen is None:
        raise no_pose_source([f"{topic} {pair.parent} to {pair.child}" for pair in samples])
    source = f"{topic} ({chosen.parent} to {chosen.child}, tf2_msgs/msg/TFMessage)"
    pair = (chosen.parent, chosen.child)
    track = _track((source, topic), pair, (chosen.stamps_ns, chosen.parent_from_child), rig)
    return _with_refused(track, chosen.refused_ns, chosen.reason, unread)


def _with_refused(
    track: PoseTrack, refused_ns: NDArray[np.int64], reason: str, others: tuple[Finding, ...]
) -> PoseTrack:
    return replace(track, findings=(*others, *refused_finding(track.topic, refused_ns, reason), *track.findings))


def child_from_ego(parent: str, child: str, rig: RigMounts) -> tuple[SE3, tuple[Finding, ...]]:
    """Return the fixed transform to the ego frame from a source's frame, with a warning if it is assumed.

    A tree without positions does not place the LiDAR in the base's frame; the given calibration does.
    """
    calibration, frame = rig.calibration, plain(child)
    lidar_from_ego = calibration.ego_from_lidar.inverse()
    if frame in BASE_FRAMES and rig.tree.unplaced:
        return (rig.base_from_lidar or calibration.ego_from_lidar) @ lidar_from_ego, ()
    if rig.lidar_frame and (child_from_lidar := rig.tree.transform(frame, rig.lidar_frame)) is not None:
        return child_from_lidar @ lidar_from_ego, ()
    for mount in calibration.mounts:
        if frame and frame == plain(mount.frame_id):
            return mount.lidar_from_sensor.inverse() @ lidar_from_ego, ()
    if frame in BASE_FRAMES and not sensor_named(parent, child):
        return SE3.identity(), ()
    return SE3.identity(), (assumed_finding(parent, child),)


def _track(
    named: tuple[str, str], pair: tuple[str, str], samples: tuple[NDArray[np.int64], SE3], rig: RigMounts
) -> PoseTrack:
    source, topic = named
    stamps_ns, fixed_from_child = samples
    if not len(stamps_ns):
        raise NoUsablePoseError(source, 0, "no message")
    is_stamped = stamps_ns != 0
    if not is_stamped.any():
        raise NoUsablePoseError(source, len(stamps_ns), "every stamp is 0")
    ordered = in_order(topic, stamps_ns, np.flatnonzero(is_stamped))
    step, findings = child_from_ego(*pair, rig)
    offset_ns = rig.clocks.of_poses(rig.calibration, pair[1])
    local = local_poses(topic, ordered.stamps_ns, fixed_from_child[ordered.index], is_course=rig.is_course)
    poses, findings = local.poses @ step, (*local.findings, *findings)
    if rig.is_course:
        poses, findings = along_course(source, local.poses.translation_m, step), (*findings, course_finding(topic))
    trajectory = Trajectory(ordered.stamps_ns[local.kept] + offset_ns, poses)
    findings += shifted_finding(topic, offset_ns) + _unstamped_finding(topic, is_stamped)
    return PoseTrack(trajectory, source, topic, ordered.findings + findings, is_course=rig.is_course)


def _unstamped_finding(topic: str, is_stamped: NDArray[np.bool_]) -> tuple[Finding, ...]:
    count = int((~is_stamped).sum())
    if not count:
        return ()
    sentence = f"{count} of {len(is_stamped)} poses are stamped 0 and are left out"
    return (Finding("MSG-311", "warning", topic, sentence),)


# Names of the frames in which a source reports poses: whether such a frame is a sensor's, and not the robot's base.
# `body` is a robot's base, but in `camera_init` the IMU of FAST-LIO and related programs, which sits above the ground.
# Source of the names: FAST_LIO, FAST-LIVO2, Point-LIO, A-LOAM and LeGO-LOAM, as they publish odometry.


SLAM_PARENT = "camera_init"
IN_SLAM = {"body": "IMU", "aft_mapped": "IMU or LiDAR", "aft_pgo": "IMU or LiDAR"}
WORDS = {
    "IMU": {"imu", "gyro", "ahrs", "xsens", "vectornav", "microstrain"},
    "LiDAR": {"lidar", "laser", "velodyne", "ouster", "os", "hesai", "pandar", "livox", "rslidar", "robosense"},
    "camera": {"camera", "cam", "optical", "zed", "realsense"},
    "receiver": {"gps", "gnss", "ins", "novatel", "antenna"},
}


def sensor_named(parent: str, child: str) -> str:
    """Return the kind of sensor that the child frame's name indicates; "" without one."""
    frame = plain(child).lower()
    if plain(parent) == SLAM_PARENT and frame in IN_SLAM:
        return IN_SLAM[frame]
    words = set(re.findall("[a-z]+", frame))
    return next((sensor for sensor, known in WORDS.items() if words & known), "")


def assumed_finding(parent: str, child: str) -> Finding:
    """Return CAL-405: the frame's place is unknown and it is taken for the ego frame."""
    if not child:
        sentence = "its messages do not name the frame of their poses; they count as poses of the ego frame"
        return Finding("CAL-405", "warning", "", f"{sentence} (give it with --poses-frame FRAME)")
    sentence = f"neither the calibration nor tf_static contains its frame {child!r}; the frame counts as the ego frame"
    if sensor := sensor_named(parent, child):
        sentence += (
            f", although its name under {parent!r} indicates the {sensor}, which is above the ground and may be "
            f"rotated. Add the sensor with frame_id {child} and its extrinsics to the calibration, or name the topic "
            "of the base's poses"
        )
    return Finding("CAL-405", "warning", child, sentence)
