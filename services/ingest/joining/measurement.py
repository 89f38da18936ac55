"""The offset of a recording's clock, measured by what its sensors saw of the robot's motion.

    cameras: turns of pictures, then the phase of their triggers   radars: Doppler   gyros: turns
    every kind against the track of the reference → one offset, weighed by the errors, where they agree

**Conventions.** An offset is added to the recording's times. A camera that fires when the LiDAR looks its way tells the
offset within a sweep to a fraction of a millisecond, and its pictures which sweep that was. Kinds that contradict each
other by more than their errors explain are refused, not averaged.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from services.ingest.pipeline import SynchroniseOptions, unjoined_sequence
from stone.sensors.association import trigger_phase_ns, typical_period_ns
from stone.sensors.lag_fit import LagEvidence, LagFit, fitted_lag
from stone.sensors.sequence import Sequence as RunSequence
from stone.sensors.triggers import LidarRotation, triggers_of
from stone_files.joined_file import CAMERAS, GYRO, RADARS, TRIGGERS
from stone_recordings.bags.bag import Bag
from stone_recordings.calibrations.file import read_calibration
from stone_recordings.clocks.triggers import bearing_rad, lidar_look
from stone_recordings.joining.clock_links import ClockOffset
from stone_recordings.joining.errors import ContradictoryOffsetsError, UnmeasuredOffsetError
from stone_recordings.joining.sensor_evidence import RobotMotion, camera_turns, gyro_turns, radar_speeds, stamps_of
from stone_recordings.report.inspection import frame_id_of
from stone_recordings.sync.association import mount_of
from stone_recordings.topics.profiles import Candidate
from stone_recordings.topics.roles import Role
from stone_recordings.topics.sources import candidate_of

Read = Callable[[Bag, Candidate, RobotMotion], LagEvidence | None]
KINDS: tuple[tuple[str, Role, Read], ...] = (
    (CAMERAS, "camera", camera_turns),
    (RADARS, "radar", radar_speeds),
    (GYRO, "imu", gyro_turns),
)
SEARCHED_S = 10.0
# Of a standard error more is no measurement, and of a sweep's period too much to tell which sweep it was.
MOST_SIGMA_S, MOST_SIGMA_PERIODS = 0.02, 0.1
SIGMAS, EXPOSURE_S = 5.0, 0.005
# Mounts say where a camera looks to about a degree, which is what a LiDAR turns through in this part of its period.
LEAST_TRIGGER_SIGMA_PERIODS = 1 / 360


@dataclass(frozen=True, eq=False)
class RunReference:
    """What offsets are measured against: the run as the reference alone tells it, and where its LiDAR looks when."""

    name: str
    sequence: RunSequence
    robot: RobotMotion
    look: LidarRotation | None


def reference_of(bag: Bag, calibration: Path, options: SynchroniseOptions) -> RunReference:
    """Raises: UnmeasuredOffsetError, and what `read_calibration` and `unjoined_sequence` raise."""
    rig, _ = read_calibration(calibration, bag)
    sequence, sweeps = unjoined_sequence(bag, rig, options, bag.path.stem)
    if sequence.track is None or len(sequence.frames) < 2:
        raise UnmeasuredOffsetError([bag.path.name], ["it has too few sweeps with a pose to compare others with"])
    look = lidar_look(bag, sweeps, typical_period_ns(sequence.frames.stamps_ns))
    return RunReference(bag.path.name, sequence, RobotMotion(sequence.track, rig, sequence.max_pose_gap_ns), look)


def measured_offset(bag: Bag, name: str, reference: RunReference) -> ClockOffset:
    """Of the recording `name`, or of several of one clock with it.

    Raises: UnmeasuredOffsetError (SYN-523), ContradictoryOffsetsError (SYN-524), and what decoding raises.
    """
    topics = [candidate_of(bag, topic) for topic in bag.topics if topic.count and topic.encoding == "cdr"]
    found, reasons = dict[str, LagFit](), list[str]()
    for kind, role, read in KINDS:
        own = [topic for topic in topics if topic.role == role]
        fit = _fit(bag, own, (read, reference.robot))
        if fit is not None:
            found[kind] = fit
        elif own:
            reasons.append(f"{len(own)} topics of its {role}s tell no time: the robot turned and sped up too little")
    if not found:
        raise UnmeasuredOffsetError([name], reasons)
    offset = _weighed(name, found)
    return _triggered(bag, [topic for topic in topics if topic.role == "camera"], reference, offset) or offset


def _fit(bag: Bag, topics: Sequence[Candidate], how: tuple[Read, RobotMotion]) -> LagFit | None:
    read, robot = how
    every = (read(bag, topic, robot) for topic in topics)
    evidence = [one for one in every if one is not None]
    fit = fitted_lag(evidence, (-SEARCHED_S, SEARCHED_S)) if evidence else None
    return fit if fit is not None and fit.sigma_s <= MOST_SIGMA_S else None


def _weighed(name: str, found: dict[str, LagFit]) -> ClockOffset:
    """The mean by inverse variance. Raises: ContradictoryOffsetsError."""
    fits = list(found.values())
    offsets, sigmas = (np.array(column) for column in zip(*((fit.offset_s, fit.sigma_s) for fit in fits), strict=True))
    weights = 1 / sigmas**2
    mean_s = float(np.sum(weights * offsets) / weights.sum())
    if (np.abs(offsets - mean_s) > SIGMAS * sigmas + EXPOSURE_S).any():
        told = [f"{fit.offset_s:+.4f} ± {fit.sigma_s:.4f} s by {kind}" for kind, fit in found.items()]
        raise ContradictoryOffsetsError(name, told)
    return ClockOffset(round(mean_s * 1e9), round(float(weights.sum()) ** -0.5 * 1e9), tuple(found))


def _triggered(
    bag: Bag, cameras: Sequence[Candidate], reference: RunReference, offset: ClockOffset
) -> ClockOffset | None:
    """By the phase of cameras that fire when the LiDAR looks their way; None where they do not, or where nothing tells
    in which sweep they did."""
    look, sigma_ns = reference.look, offset.sigma_ns or 0
    if look is None or sigma_ns > MOST_SIGMA_PERIODS * look.period_ns:
        return None
    fired, looks = list[int](), list[int]()
    for topic in cameras:
        recorded = next(one for one in bag.topics if one.name == topic.name)
        mount = mount_of(topic.name, frame_id_of(bag, recorded), "camera", reference.robot.calibration)
        if mount is not None:
            stamps_ns = stamps_of(bag, topic) + offset.offset_ns
            fired.append(trigger_phase_ns(reference.sequence.frames.stamps_ns, stamps_ns, look.period_ns))
            looks.append(look.time_ns(bearing_rad(mount)))
    triggers = triggers_of(np.array(fired, np.int64), np.array(looks, np.int64), look.period_ns)
    if triggers is None or abs(triggers.shared_ns) > SIGMAS * sigma_ns + EXPOSURE_S * 1e9:
        return None
    scatter_ns = float(np.std(triggers.late_ns, ddof=1)) / np.sqrt(len(fired))
    sigma_ns = round(max(scatter_ns, LEAST_TRIGGER_SIGMA_PERIODS * look.period_ns))
    return ClockOffset(offset.offset_ns - triggers.shared_ns, sigma_ns, (*offset.known_by, TRIGGERS))
