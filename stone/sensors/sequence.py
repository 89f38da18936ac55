"""A synchronised sequence, passed from ingest to the labeler: its frames, its calibration and its sweeps.

**Conventions.** Time is integer nanoseconds. A frame is the synchronised sample at one LiDAR stamp; its token is
`frame_token(sequence name, stamp)`. Poses are `map_from_ego` at the stamp.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from stone.errors import Refused
from stone.findings import Finding
from stone.geometry.se3 import SE3
from stone.geometry.trajectory import DEFAULT_MAX_GAP_NS, Trajectory
from stone.sensors.calibration import Calibration
from stone.sensors.ground_plane import GroundFit
from stone.sensors.height_drift import HeightDrift
from stone.sensors.pose_quality import PoseQuality
from stone_base.names import NAME as NAME


def bad_sequence_name(name: str) -> Refused:
    return Refused(
        "bad_sequence_name",
        f"{name[:120]!r} is not a valid sequence name: use 1 to 100 letters, digits, dots, dashes and "
        "underscores, starting with a letter or digit (is it a path?)",
    )


@dataclass(frozen=True, eq=False)
class Sweep:
    """One LiDAR revolution, deskewed to its stamp: finite, non-zero points (N, 3) float32 in the LiDAR frame.

    `beyond` counts its message's points outside the reach of any LiDAR (`stone.sensors.reach`), `mistimed` its points
    without a valid time. A sweep that is not `is_timed` has no times and is not deskewed.
    """

    stamp_ns: int
    points_lidar: NDArray[np.float32]
    beyond: int = 0
    mistimed: int = 0
    is_timed: bool = True


@dataclass(frozen=True, eq=False)
class Association:
    """The message of one sensor for each frame: index −1 and dt 0 if none is near enough; dt is signed.

    `phase_ns` is the delay of a triggered camera after the frame's stamp, estimated from the recording; otherwise None.
    """

    topic: str
    message_index: NDArray[np.int64]
    dt_ns: NDArray[np.int64]
    phase_ns: int | None = None


@dataclass(frozen=True, eq=False)
class Slices:
    """The samples of a fast sensor between frames: `start` (N + 1,); frame i has samples start[i] to start[i + 1].

    Samples are counted in stamp order without repeats, from the frame's stamp (included) to the next frame's; the last
    frame's samples cover one LiDAR period.
    """

    topic: str
    start: NDArray[np.int64]


@dataclass(frozen=True)
class ExcludedFrame:
    """A LiDAR stamp without a frame, and the reason (`code` for programs, `reason` for people)."""

    stamp_ns: int
    code: str
    reason: str


@dataclass(frozen=True, eq=False)
class Frames:
    """The frame table: N usable frames in time order; `sweeps` are the LiDAR's messages, `slices` by channel.

    `quality` and `sweeps` are None for frames without a recording.
    """

    stamps_ns: NDArray[np.int64]
    tokens: tuple[str, ...]
    map_from_ego: SE3
    associations: Mapping[str, Association] = field(default_factory=dict)
    slices: Mapping[str, Slices] = field(default_factory=dict)
    quality: PoseQuality | None = None
    sweeps: Association | None = None

    def __len__(self) -> int:
        return len(self.tokens)


@dataclass(frozen=True)
class RecordingClock:
    """One of a sequence's recordings, and the offset added to its times to convert them to the first recording's clock.

    `sigma_ns` is the offset's standard error, None if it was not measured; `known_by` is its source.
    """

    name: str
    offset_ns: int
    sigma_ns: int | None
    known_by: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Sequence:
    """One continuous run of the robot, synchronised; `inputs` identifies its sources (name → sha256).

    `track` is the robot's path between the frames by the original poses, before any refinement of the frames' poses;
    intervals longer than `max_pose_gap_ns` are gaps. None for frames without a recording. `map_of_segment` is the map
    of each track segment, () if each has its own. `ground` is the position of the ground in the ego frame, and
    `height_drift` the poses' drift in z relative to it; None if not measured. `recordings` are the joined recordings,
    () for a single one.
    """

    name: str
    frames: Frames
    excluded: tuple[ExcludedFrame, ...]
    calibration: Calibration
    pose_source: str
    map_origin_deg_m: tuple[float, float, float] | None = None
    inputs: Mapping[str, str] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    track: Trajectory | None = None
    max_pose_gap_ns: int = DEFAULT_MAX_GAP_NS
    map_of_segment: tuple[int, ...] = ()
    ground: GroundFit | None = None
    height_drift: HeightDrift | None = None
    recordings: tuple[RecordingClock, ...] = ()

    def __post_init__(self) -> None:
        if not NAME.fullmatch(self.name):
            raise bad_sequence_name(self.name)


class SweepSource(Protocol):
    """The source of sweeps: a recording on disk, or arrays in memory. Picklable, so that workers can open it."""

    def sweep(self, index: int) -> Sweep:
        """Return the sweep of frame `index`."""
        ...


def frame_token(sequence_name: str, stamp_ns: int) -> str:
    """Return the first 32 hex digits of sha256("<sequence name>:<stamp_ns>") (design §3)."""
    return sha256(f"{sequence_name}:{stamp_ns}".encode()).hexdigest()[:32]
