"""Association of the other sensors' messages with a frame, by channel, phase and nearness.

**Conventions.** Radar and IMU give the nearest sample within half their period and a jitter. An IMU also gives its
samples from frame to frame; a camera gives the image taken in its phase of the sweep. `dt_ns` is sample − frame, after
the mount's `time_offset_ns` was added to the sample.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone.sensors.association import nearest_samples, triggered_samples, typical_period_ns
from stone.sensors.calibration import Calibration, Mount
from stone.sensors.sequence import Association, Frames, Slices
from stone_recordings.poses.extrinsics import plain
from stone_recordings.sync.recorded_messages import OrderedStamps, RecordedTopics, in_order
from stone_recordings.sync.synchronisation import PosedFrames
from stone_recordings.topics.profiles import channel_of
from stone_recordings.topics.roles import Role
from stone_recordings.topics.sources import Sources

# A sensor's own jitter on top of half its period (design §3): a tenth of the period, at least a millisecond.
JITTER_PERIODS, LEAST_JITTER_NS = 10, 1_000_000
PHASE_RESIDUAL_LIMIT_NS = 2_000_000


@dataclass(frozen=True, eq=False)
class SensorTopics:
    """The recorded topics of the other sensors; `channel_of` names the channel of a topic."""

    recorded: RecordedTopics
    sources: Sources
    calibration: Calibration
    channel_of: Mapping[str, str]


def associate(topics: SensorTopics, posed: PosedFrames) -> tuple[Frames, tuple[Finding, ...]]:
    """Return the frames with one association per topic, under its channel in the calibration, else its own name."""
    associations: dict[str, Association] = {}
    slices: dict[str, Slices] = {}
    findings: list[Finding] = []
    for topic, role in topics.sources.associated:
        mount = _mount(topics, topic.name, role)
        key = mount.name if mount is not None and mount.name not in associations else topic.name
        late_ns = mount.time_offset_ns if mount is not None else 0
        usable = topics.recorded.usable(topic.name)
        findings += topics.recorded.left_out(topic.name)
        if not len(usable):
            continue
        ordered = in_order(topic.name, topics.recorded.stamps_ns(topic.name) + late_ns, usable)
        associations[key], noticed = _association(topic.name, role, ordered, posed)
        findings += [*ordered.findings, *noticed]
        if role == "imu":
            slices[key] = Slices(topic.name, _starts(posed, ordered.stamps_ns))
    return replace(posed.frames, associations=associations, slices=slices), tuple(findings)


def mount_of(topic: str, frame_id: str, role: Role, calibration: Calibration) -> Mount | None:
    """Return the mount of a topic: by the frame of its messages, else by a channel in its name
    (/radar_left/detections).

    If neither decides, the words of the names do, provided that they name exactly one channel.
    """
    mounts = [mount for mount in calibration.mounts if mount.kind == role]
    for mount in mounts:
        if mount.frame_id and plain(mount.frame_id) == plain(frame_id):
            return mount
    parts = topic.lower().split("/")
    spelt = next((mount for mount in mounts if mount.name.lower() in parts), None)
    if spelt is not None or role not in ("camera", "radar"):
        return spelt
    channel = channel_of(role, topic, frame_id, {})
    return next((mount for mount in mounts if mount.name == channel), None)


def _mount(topics: SensorTopics, topic: str, role: Role) -> Mount | None:
    """Return the mount of the channel chosen for this topic, else the mount that `mount_of` returns."""
    named = topics.calibration.mount(topics.channel_of.get(topic, ""))
    if named is not None and named.kind == role:
        return named
    return mount_of(topic, topics.recorded.frame_id(topic), role, topics.calibration)


def _association(
    topic: str, role: Role, ordered: OrderedStamps, posed: PosedFrames
) -> tuple[Association, list[Finding]]:
    frames_ns, findings = posed.frames.stamps_ns, list[Finding]()
    phase_ns: int | None = None
    if role == "camera":
        nearest, phase_ns = triggered_samples(frames_ns, ordered.stamps_ns, posed.period_ns)
        late_ns = np.abs(nearest.dt_ns - phase_ns)[nearest.index >= 0]
        findings += _phase_finding(topic, late_ns, phase_ns)
    else:
        period_ns = typical_period_ns(ordered.stamps_ns)
        tolerance_ns = period_ns // 2 + max(period_ns // JITTER_PERIODS, LEAST_JITTER_NS)
        nearest = nearest_samples(frames_ns, ordered.stamps_ns, tolerance_ns)
    index = np.where(nearest.index >= 0, ordered.index[nearest.index], -1)
    missing = int((index < 0).sum())
    if missing:
        sentence = f"{missing} of {len(index)} frames have no message of this topic near enough in time"
        findings.append(Finding("SYN-504", "warning", topic, sentence))
    return Association(topic, index, nearest.dt_ns, phase_ns), findings


def _phase_finding(topic: str, late_ns: NDArray[np.int64], phase_ns: int) -> list[Finding]:
    is_late = late_ns > PHASE_RESIDUAL_LIMIT_NS
    if not is_late.any():
        return []
    sentence = (
        f"fired more than {PHASE_RESIDUAL_LIMIT_NS / 1e6:g} ms off its phase of {phase_ns / 1e6:.2f} ms in "
        f"{is_late.mean() * 100:.1f} % of the frames (worst {late_ns.max() / 1e6:.2f} ms)"
    )
    return [Finding("TIM-205", "warning", topic, sentence)]


def _starts(posed: PosedFrames, stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the first sample of each frame (N + 1,); the samples of the last frame end one typical sweep period after
    it.
    """
    edges_ns = np.append(posed.frames.stamps_ns, posed.frames.stamps_ns[-1] + posed.period_ns)
    return np.searchsorted(stamps_ns, edges_ns, side="left").astype(np.int64)
