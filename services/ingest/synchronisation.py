"""Frames at the LiDAR's stamps: their poses, their exclusions, and the other sensors' messages that belong to them.

**Conventions.** A frame needs a pose at its stamp, and, where points carry time, over its whole sweep: nothing is
extrapolated. Radar and IMU give the nearest sample within half their period and a jitter; a camera gives the image it
took in its phase of the sweep. `dt_ns` is sample − frame, after the mount's `time_offset_ns` was added to the sample.
"""

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.ingest.extrinsics import plain
from services.ingest.lidar_clock import LidarClock
from services.ingest.recorded import Ordered, Recorded, in_order
from services.ingest.roles import Role
from services.ingest.sources import Sources
from services.ingest.synchronisation_errors import NoFramesError
from stone.association import nearest_samples, triggered_samples, typical_period_ns
from stone.calibration import Calibration, Mount
from stone.findings import Finding
from stone.sequence import Association, ExcludedFrame, Frames, frame_token
from stone.trajectory import Interpolated, PoseStatus, Trajectory

# A sensor's own jitter on top of half its period (design §3): a tenth of the period, at least a millisecond.
JITTER_PERIODS, LEAST_JITTER_NS = 10, 1_000_000
PHASE_RESIDUAL_LIMIT_NS = 2_000_000

EXCLUSIONS = {
    PoseStatus.BEFORE_FIRST: "no_pose_before_first",
    PoseStatus.AFTER_LAST: "no_pose_after_last",
    PoseStatus.GAP: "pose_gap",
}


@dataclass(frozen=True, eq=False)
class PosedFrames:
    """`message_index` (N,) of each frame's sweep in its topic; `period_ns` of all sweeps, usable or not."""

    frames: Frames
    period_ns: int
    message_index: NDArray[np.int64]
    excluded: tuple[ExcludedFrame, ...]


def frames_with_pose(name: str, clock: LidarClock, trajectory: Trajectory, max_gap_ns: int) -> PosedFrames:
    """Every LiDAR stamp, as a frame or as an exclusion with its reason. Raises NoFramesError when none has a pose."""
    stamps_ns = clock.ordered.stamps_ns
    at_stamp = trajectory.at(stamps_ns, max_gap_ns)
    at_ends = [trajectory.at(stamps_ns + offset_ns, max_gap_ns) for offset_ns in clock.span_ns]
    is_empty = clock.points == 0
    is_usable = at_stamp.is_ok & at_ends[0].is_ok & at_ends[1].is_ok & ~is_empty
    rows = np.flatnonzero(is_usable)
    tokens = tuple(frame_token(name, stamp_ns) for stamp_ns in stamps_ns[rows].tolist())
    frames = Frames(stamps_ns[rows], tokens, at_stamp.map_from_ego[rows])
    excluded = tuple(
        _exclusion(int(stamps_ns[row]), bool(is_empty[row]), [_found_at(found, row) for found in (at_stamp, *at_ends)])
        for row in np.flatnonzero(~is_usable).tolist()
    )
    if not len(rows):
        raise NoFramesError(counted_reasons(excluded), _seconds(stamps_ns), _seconds(trajectory.stamps_ns))
    return PosedFrames(frames, typical_period_ns(stamps_ns), clock.ordered.index[rows], excluded)


def usable_finding(posed: PosedFrames) -> tuple[Finding, ...]:
    """How many sweeps are frames, when not all are."""
    if not posed.excluded:
        return ()
    total = len(posed.frames) + len(posed.excluded)
    sentence = f"{len(posed.frames)} of {total} sweeps are frames; excluded: {counted_reasons(posed.excluded)}"
    return (Finding("SYN-501", "warning", "", sentence),)


def counted_reasons(excluded: tuple[ExcludedFrame, ...]) -> str:
    """ "3 no_pose_after_last, 1 pose_gap"."""
    counts = Counter(frame.code for frame in excluded)
    return ", ".join(f"{count} {code}" for code, count in sorted(counts.items()))


def _found_at(found: Interpolated, row: int) -> tuple[PoseStatus, int]:
    return PoseStatus(int(found.status[row])), int(found.gap_ns[row])


def _seconds(stamps_ns: NDArray[np.int64]) -> tuple[float, float]:
    return int(stamps_ns[0]) / 1e9, int(stamps_ns[-1]) / 1e9


def _exclusion(stamp_ns: int, is_empty: bool, found: list[tuple[PoseStatus, int]]) -> ExcludedFrame:
    if is_empty:
        return ExcludedFrame(stamp_ns, "empty_sweep", "the sweep has no points")
    place = next(place for place, (status, _) in enumerate(found) if status != PoseStatus.OK)
    status, gap_ns = found[place]
    when = ("the stamp", "the sweep's first point", "the sweep's last point")[place]
    if status == PoseStatus.GAP:
        reason = f"{when} lies in a gap of {gap_ns / 1e6:.1f} ms between two poses"
    else:
        reason = f"{when} lies {'before the first' if status == PoseStatus.BEFORE_FIRST else 'after the last'} pose"
    return ExcludedFrame(stamp_ns, EXCLUSIONS[status], reason)


def associate(
    recorded: Recorded, sources: Sources, calibration: Calibration, posed: PosedFrames
) -> tuple[dict[str, Association], tuple[Finding, ...]]:
    """One association per topic, under the channel the calibration knows it by, else under the topic's own name."""
    associations: dict[str, Association] = {}
    findings: list[Finding] = []
    for topic, role in sources.associated:
        mount = mount_of(topic.name, recorded.frame_id(topic.name), role, calibration)
        key = mount.name if mount is not None and mount.name not in associations else topic.name
        ordered = in_order(topic.name, recorded.stamps_ns(topic.name) + (mount.time_offset_ns if mount else 0))
        associations[key], noticed = _association(topic.name, role, ordered, posed)
        findings += [*ordered.findings, *noticed]
    return associations, tuple(findings)


def mount_of(topic: str, frame_id: str, role: Role, calibration: Calibration) -> Mount | None:
    """By the frame the messages are in, else by a channel spelt out in the topic (/radar_left/detections)."""
    mounts = [mount for mount in calibration.mounts if mount.kind == role]
    for mount in mounts:
        if mount.frame_id and plain(mount.frame_id) == plain(frame_id):
            return mount
    parts = topic.lower().split("/")
    return next((mount for mount in mounts if mount.name.lower() in parts), None)


def _association(topic: str, role: Role, ordered: Ordered, posed: PosedFrames) -> tuple[Association, list[Finding]]:
    frames_ns, findings = posed.frames.stamps_ns, list[Finding]()
    if role == "camera":
        found, phase_ns = triggered_samples(frames_ns, ordered.stamps_ns, posed.period_ns)
        late_ns = np.abs(found.dt_ns - phase_ns)[found.index >= 0]
        findings += _phase_finding(topic, late_ns, phase_ns)
    else:
        period_ns = typical_period_ns(ordered.stamps_ns)
        tolerance_ns = period_ns // 2 + max(period_ns // JITTER_PERIODS, LEAST_JITTER_NS)
        found = nearest_samples(frames_ns, ordered.stamps_ns, tolerance_ns)
    index = np.where(found.index >= 0, ordered.index[found.index], -1)
    missing = int((index < 0).sum())
    if missing:
        sentence = f"{missing} of {len(index)} frames have no message of it near enough"
        findings.append(Finding("SYN-504", "warning", topic, sentence))
    return Association(topic, index, found.dt_ns), findings


def _phase_finding(topic: str, late_ns: NDArray[np.int64], phase_ns: int) -> list[Finding]:
    is_late = late_ns > PHASE_RESIDUAL_LIMIT_NS
    if not is_late.any():
        return []
    sentence = (
        f"fired more than {PHASE_RESIDUAL_LIMIT_NS / 1e6:g} ms off its phase of {phase_ns / 1e6:.2f} ms in "
        f"{is_late.mean() * 100:.1f} % of the frames (worst {late_ns.max() / 1e6:.2f} ms)"
    )
    return [Finding("TIM-205", "warning", topic, sentence)]
