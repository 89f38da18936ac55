"""The ego trajectory from a file of poses beside the recording.

**Conventions.** A file tells the pose of one frame of the robot: the one named, else the ego frame, which is said. The
fixed frame of a TUM file is the map. That of a KITTI file is its own frame at the first pose, which may be a camera's:
the map is the ego frame at the first sweep then, so that z is as upright as the robot stood.
"""

from dataclasses import dataclass
from pathlib import Path

from stone.findings import Finding
from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone_recordings.clocks.lidar_clock import LidarClock
from stone_recordings.poses.extrinsics import BASE_FRAMES, plain
from stone_recordings.poses.pose_file import FilePoses, read_pose_file
from stone_recordings.poses.sources import PoseTrack, RigMounts, child_from_ego
from stone_recordings.sync.clock_offsets import shifted_finding
from stone_recordings.sync.errors import PoseFileMismatchError


@dataclass(frozen=True)
class PoseFile:
    """A file of poses of the frame `frame` of the robot; "" where nobody says of which."""

    path: Path
    frame: str = ""


def track_from_file(file: PoseFile, clock: LidarClock, rig: RigMounts) -> PoseTrack:
    """Raises PoseFileError, PoseFileMismatchError (another number of poses than sweeps, a frame nobody knows)."""
    read = read_pose_file(file.path)
    source, inputs = f"{read.name} ({read.format})", {f"poses {read.name}": read.sha256}
    step, findings = _child_from_ego(read.name, file.frame, rig)
    offset_ns = rig.clocks.of_poses(rig.calibration, file.frame)
    findings += shifted_finding(read.name, offset_ns)
    if read.stamps_ns is not None:
        trajectory = Trajectory(read.stamps_ns + offset_ns, read.poses @ step)
        return PoseTrack(trajectory, source, read.name, findings, inputs=inputs)
    stamps_ns = clock.ordered.stamps_ns
    if len(stamps_ns) != len(read.poses):
        raise PoseFileMismatchError(read.name, _counts(read, clock))
    first_from_child = read.poses[0].inverse() @ read.poses
    trajectory = Trajectory(stamps_ns, step.inverse() @ first_from_child @ step)
    return PoseTrack(trajectory, source, read.name, findings, inputs=inputs)


def _child_from_ego(name: str, frame: str, rig: RigMounts) -> tuple[SE3, tuple[Finding, ...]]:
    for mount in rig.calibration.mounts:
        if frame and frame == mount.name:
            return (rig.calibration.ego_from_lidar @ mount.lidar_from_sensor).inverse(), ()
    if not frame:
        sentence = "it does not name the frame of its poses; they are taken as poses of the ego frame (--poses-frame)"
        return SE3.identity(), (Finding("CAL-405", "warning", name, sentence),)
    step, assumed = child_from_ego("", frame, rig)
    if assumed:
        known = [mount.name for mount in rig.calibration.mounts] + [m.frame_id for m in rig.calibration.mounts]
        names = ", ".join(dict.fromkeys([*BASE_FRAMES[:1], plain(rig.lidar_frame), *known][:8]))
        raise PoseFileMismatchError(name, f"unknown frame {frame[:60]!r}; known are {names}")
    return step, ()


def _counts(read: FilePoses, clock: LidarClock) -> str:
    return (
        f"it has {len(read.poses)} poses, {clock.topic} has {len(clock.ordered.stamps_ns)} usable sweeps; a KITTI file "
        "has no stamps and needs one pose a sweep: write the poses as TUM (time x y z qx qy qz qw)"
    )
