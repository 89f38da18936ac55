"""The ego trajectory from a file of poses beside the recording.

**Conventions.** A file contains the poses of one frame of the robot: the named frame, else the ego frame, with a
finding. The fixed frame of a TUM file is the map. The fixed frame of a KITTI file is its own frame at the first pose,
which may be a camera's. Then the map is the ego frame at the first sweep, so that z is as upright as the robot.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal
from hashlib import sha256
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from stone.errors import Refused
from stone.findings import Finding
from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone_recordings.clocks.lidar_clock import LidarClock
from stone_recordings.messages.batch import MOST_POSITION_M
from stone_recordings.messages.types.cdr import NS_PER_S
from stone_recordings.poses.extrinsics import BASE_FRAMES, plain
from stone_recordings.poses.places import local_poses
from stone_recordings.poses.sources import PoseTrack, RigMounts, child_from_ego
from stone_recordings.sync.clock_offsets import shifted_finding

# Files of poses beside a recording: TUM (stamped) and KITTI (one pose a sweep), distinguished by their numbers per
# line. TUM: `time x y z qx qy qz qw`, seconds since 1970, metres; its fixed frame has z up. KITTI: the twelve numbers
# of a 3 × 4 matrix, row by row, without stamps: line i is the pose at sweep i. `#` starts a comment, empty lines are
# skipped. Source: TUM RGB-D benchmark (file formats), KITTI odometry devkit (readme).


LARGEST_BYTES, LONGEST_LINE, MOST_POSES = 256 << 20, 1000, 2_000_000
COLUMNS: dict[int, Literal["TUM", "KITTI"]] = {8: "TUM", 12: "KITTI"}
NUMBER = re.compile(
    r"[+-]?(\d{1,40}\.?\d{0,40}|\.\d{1,40})([eE][+-]?\d{1,3})?|[+-]?(nan|inf)", re.ASCII | re.IGNORECASE
)
LAST_S = 9_000_000_000
MOST_OFF_NORM, MOST_OFF_ROTATION = 1e-2, 5e-3


EULER = " (if the columns are roll, pitch and yaw, convert them to a quaternion)"


@dataclass(frozen=True, eq=False)
class FilePoses:
    """N poses; `stamps_ns` (N,) strictly increases, and is None for KITTI. `sha256` is that of the file."""

    name: str
    format: Literal["TUM", "KITTI"]
    poses: SE3
    stamps_ns: NDArray[np.int64] | None
    sha256: str


def read_pose_file(path: Path) -> FilePoses:
    """Read a file of poses. Raises `SYN-516` with the line of the first fault, OSError."""
    digest, numbers, lines, stamps = sha256(), list[list[float]](), list[int](), list[int]()
    if path.stat().st_size > LARGEST_BYTES:
        raise bad_pose_file(path.name, 0, f"it has more than {LARGEST_BYTES} bytes")
    for number, raw in _lines(path):
        digest.update(raw)
        words = _words(path.name, number, raw)
        if not words:
            continue
        expected = len(numbers[0]) if numbers else None
        numbers.append(_row(path.name, number, words, expected))
        lines.append(number)
        if len(words) == 8:
            stamps.append(_stamp_ns(path.name, number, words[0]))
        if len(numbers) > MOST_POSES:
            raise bad_pose_file(path.name, number, f"it has more than {MOST_POSES} poses")
    if not numbers:
        raise bad_pose_file(path.name, 0, "it contains no pose")
    table, at = np.array(numbers, np.float64), np.array(lines, np.int64)
    if table.shape[1] == 12:
        return FilePoses(path.name, "KITTI", _kitti(path.name, table, at), None, digest.hexdigest())
    stamps_ns = np.array(stamps, np.int64)
    _check_order(path.name, stamps_ns, at)
    return FilePoses(path.name, "TUM", _tum(path.name, table, at), stamps_ns, digest.hexdigest())


def _lines(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield the lines with their numbers from 1. Raises `SYN-516` for a line longer than any pose."""
    with path.open("rb") as file:
        number = 0
        while raw := file.readline(LONGEST_LINE + 1):
            number += 1
            if len(raw) > LONGEST_LINE:
                raise bad_pose_file(path.name, number, f"the line has more than {LONGEST_LINE} characters")
            yield number, raw


def _words(name: str, number: int, raw: bytes) -> list[str]:
    try:
        return raw.decode("utf-8-sig" if number == 1 else "utf-8").partition("#")[0].split()
    except UnicodeDecodeError:
        raise bad_pose_file(name, number, "the line is not text; give a file of poses") from None


def _row(name: str, number: int, words: list[str], expected: int | None) -> list[float]:
    if expected is None and len(words) not in COLUMNS:
        raise bad_pose_file(name, number, f"the line has {len(words)} words; TUM has 8 numbers, KITTI 12{EULER}")
    if expected is not None and len(words) != expected:
        raise bad_pose_file(name, number, f"the line has {len(words)} words, the lines before it {expected}")
    wrong = [word for word in words if not NUMBER.fullmatch(word)]
    if wrong:
        raise bad_pose_file(name, number, f"{wrong[0][:40]!r} is not a number")
    row = [float(word) for word in words]
    if not np.isfinite(row).all():
        raise bad_pose_file(name, number, "a number is not finite")
    return row


def _stamp_ns(name: str, number: int, word: str) -> int:
    """Return all digits of a time, which float64 does not keep."""
    seconds = Decimal(word)
    if not 0 < seconds <= LAST_S:
        raise bad_pose_file(name, number, f"the time {word[:40]} is not in seconds since 1970 (0 to {LAST_S})")
    return int((seconds * NS_PER_S).to_integral_value())


def _check_order(name: str, stamps_ns: NDArray[np.int64], lines: NDArray[np.int64]) -> None:
    late = np.flatnonzero(np.diff(stamps_ns) <= 0)
    if len(late):
        raise bad_pose_file(name, int(lines[late[0] + 1]), f"its time is not after that of line {lines[late[0]]}")


def _check_places(name: str, places_m: NDArray[np.float64], lines: NDArray[np.int64]) -> None:
    far = np.flatnonzero((np.abs(places_m) > MOST_POSITION_M).any(axis=1))
    if len(far):
        worst_m = np.abs(places_m[far[0]]).max()
        raise bad_pose_file(
            name, int(lines[far[0]]), f"its position of {worst_m:.3g} m is beyond {MOST_POSITION_M:g} m"
        )


def _tum(name: str, table: NDArray[np.float64], lines: NDArray[np.int64]) -> SE3:
    _check_places(name, table[:, 1:4], lines)
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(table[:, 4:], axis=1)
    off = np.flatnonzero(~(np.abs(norm - 1) <= MOST_OFF_NORM))
    if len(off):
        raise bad_pose_file(
            name, int(lines[off[0]]), f"its quaternion has the norm {norm[off[0]]:.4g}, it must be 1{EULER}"
        )
    return SE3.from_parts(table[:, [7, 4, 5, 6]], table[:, 1:4])


def _kitti(name: str, table: NDArray[np.float64], lines: NDArray[np.int64]) -> SE3:
    matrix = table.reshape(-1, 3, 4)
    _check_places(name, matrix[:, :, 3], lines)
    turn = matrix[:, :, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        apart = np.abs(np.swapaxes(turn, 1, 2) @ turn - np.eye(3)).max(axis=(1, 2))
        is_turn = (apart <= MOST_OFF_ROTATION) & (np.linalg.det(np.nan_to_num(turn)) > 0)
    off = np.flatnonzero(~is_turn)
    if len(off):
        why = f"its 3 × 3 part is not a rotation (off by {apart[off[0]]:.3g})"
        raise bad_pose_file(name, int(lines[off[0]]), why)
    left, _, right = np.linalg.svd(turn)
    whole = np.tile(np.eye(4), (len(table), 1, 1))
    whole[:, :3, :3], whole[:, :3, 3] = left @ right, matrix[:, :, 3]
    return SE3.from_matrix(whole)


@dataclass(frozen=True)
class PoseFile:
    """A file of poses of the robot's frame `frame`; "" if no frame is given."""

    path: Path
    frame: str = ""


def track_from_file(file: PoseFile, clock: LidarClock, rig: RigMounts) -> PoseTrack:
    """Return the track. Raises `SYN-516`, `SYN-517` (another number of poses than sweeps, an unknown frame)."""
    read = read_pose_file(file.path)
    source, inputs = f"{read.name} ({read.format})", {f"poses {read.name}": read.sha256}
    step, findings = _child_from_ego(read.name, file.frame, rig)
    offset_ns = rig.clocks.of_poses(rig.calibration, file.frame)
    findings += shifted_finding(read.name, offset_ns)
    if read.stamps_ns is not None:
        local = local_poses(read.name, read.stamps_ns, read.poses)
        trajectory = Trajectory(read.stamps_ns[local.kept] + offset_ns, local.poses @ step)
        return PoseTrack(trajectory, source, read.name, (*local.findings, *findings), inputs=inputs)
    stamps_ns = clock.ordered.stamps_ns
    if len(stamps_ns) != len(read.poses):
        raise Refused("SYN-517", f"{read.name}: {_counts(read, clock)}")
    first_from_child = read.poses[0].inverse() @ read.poses
    trajectory = Trajectory(stamps_ns, step.inverse() @ first_from_child @ step)
    return PoseTrack(trajectory, source, read.name, findings, inputs=inputs)


def _child_from_ego(name: str, frame: str, rig: RigMounts) -> tuple[SE3, tuple[Finding, ...]]:
    for mount in rig.calibration.mounts:
        if frame and frame == mount.name:
            return (rig.calibration.ego_from_lidar @ mount.lidar_from_sensor).inverse(), ()
    if not frame:
        sentence = "it does not name the frame of its poses; they count as poses of the ego frame (--poses-frame)"
        return SE3.identity(), (Finding("CAL-405", "warning", name, sentence),)
    step, assumed = child_from_ego("", frame, rig)
    if assumed:
        known = [mount.name for mount in rig.calibration.mounts] + [m.frame_id for m in rig.calibration.mounts]
        names = ", ".join(dict.fromkeys([*BASE_FRAMES[:1], plain(rig.lidar_frame), *known][:8]))
        raise Refused("SYN-517", f"{name}: unknown frame {frame[:60]!r}; known are {names}")
    return step, ()


def _counts(read: FilePoses, clock: LidarClock) -> str:
    return (
        f"it has {len(read.poses)} poses, {clock.topic} has {len(clock.ordered.stamps_ns)} usable sweeps. A KITTI file "
        "has no stamps and needs one pose per sweep: write the poses as TUM (time x y z qx qy qz qw)"
    )


def bad_pose_file(name: str, line: int, fault: str) -> Refused:
    where = f"{name}, line {line}" if line else name
    return Refused("SYN-516", f"{where}: {fault}; a line is `time x y z qx qy qz qw` (TUM) or a 3 × 4 matrix (KITTI)")
