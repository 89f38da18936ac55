"""The clock offset of every recording: given, derived from shared messages, or measured by sensors.

**Conventions.** Recordings that share messages or continue each other's topics are a group with one clock: an offset of
one recording holds for all. `held[0]` is the reference.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from services.ingest.pipeline import SynchroniseOptions, unjoined_sequence
from stone.sensors.association import trigger_phase_ns, typical_period_ns
from stone.sensors.lag_fit import LagEvidence, LagFit, fitted_lag
from stone.sensors.sequence import Sequence as RunSequence
from stone.sensors.sweep_lag import SweepLag
from stone.sensors.triggers import LidarRotation, triggers_of
from stone_files.joined_file import (
    CAMERAS,
    GIVEN,
    GYRO,
    MOST_MEMBERS,
    RADARS,
    REFERENCE,
    SWEEPS,
    TRIGGERS,
    JoinedMember,
    is_joined,
    is_member_name,
)
from stone_files.recording_name import sequence_name
from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.bags.errors import (
    ByteOrderError,
    CloudLayoutError,
    DefinitionMissingError,
    IngestError,
    MessageLayoutError,
)
from stone_recordings.bags.joined.joined_store import check_types
from stone_recordings.bags.private_folder import PrivateFolder
from stone_recordings.calibrations.file import read_calibration
from stone_recordings.clocks.triggers import bearing_rad, lidar_look
from stone_recordings.joining.clock_links import ClockOffset, HeldMessages, held_by, left_out, linked
from stone_recordings.joining.joined_recording import (
    OPTION,
    JoinedRecording,
    no_common_time,
    unmeasured_offset,
    write_joined,
)
from stone_recordings.joining.sensor_evidence import RobotMotion, camera_turns, gyro_turns, radar_speeds, stamps_of
from stone_recordings.report.inspection import frame_id_of
from stone_recordings.sync.association import mount_of
from stone_recordings.sync.errors import no_lidar
from stone_recordings.sync.lag_check import MOST_SIGMA_NS, measured_lag
from stone_recordings.sync.sweeps import SweepsOfOpenBag
from stone_recordings.topics.profiles import Candidate
from stone_recordings.topics.roles import POSE_ROLES, Role
from stone_recordings.topics.sources import KISS_ICP, candidate_of
from stone_recordings.topics.unread_topics import not_read, unread_points

# The offset of the recording with the poses, if it is not the recording with the LiDAR. Rotations between registered
# sweeps are compared with those of the poses until they agree (`stone_recordings.sync.lag_check`). Poses with GPS time
# are on no recorder's clock and need no offset; the offset of the recording's own clock is then measured against them
# like any other.


ROUNDS = 4
OpenAt = Callable[[ClockOffset], AbstractContextManager[Bag]]


def has_poses(held: Iterable[HeldMessages], options: SynchroniseOptions) -> bool:
    """Return whether these recordings, or the options, have poses."""
    topic = options.odometry_topic or options.topics.get("pose")
    return options.poses is not None or topic == KISS_ICP or any(recording.of_role(*POSE_ROLES) for recording in held)


def best_poses(held: Iterable[HeldMessages]) -> HeldMessages | None:
    """Return the recording whose poses are used, or None if no recording has poses."""
    ranked = {role: rank for rank, role in enumerate(POSE_ROLES)}
    candidates = [
        (min(ranked[topic.role] for topic in topics), recording)
        for recording in held
        if (topics := recording.of_role(*POSE_ROLES))
    ]
    return min(candidates, key=lambda ranks: ranks[0])[1] if candidates else None


def bears_gps_time(held: HeldMessages) -> bool:
    """Return whether the recording's selected poses have GPS time."""
    return bool(held.of_role("ins"))


def pose_offset(name: str, open_at: OpenAt, calibration: Path, options: SynchroniseOptions) -> ClockOffset:
    """Return the offset of the recording `name`; `open_at` opens the run with the recording at an offset.

    Raises: `SYN-523`, and what synchronising raises.
    """
    offset_ns, sigma_ns = 0, 0
    for _ in range(ROUNDS):
        with open_at(ClockOffset(offset_ns, None, (SWEEPS,))) as bag:
            lag = _lag(bag, calibration, options)
        if lag is None or lag.sigma_ns > MOST_SIGMA_NS:
            raise unmeasured_offset([name], ["its poses and the sweeps rotate too little for a comparison"])
        offset_ns, sigma_ns = offset_ns - lag.lag_ns, lag.sigma_ns
        if 2 * abs(lag.lag_ns) < lag.sigma_ns:
            break
    return ClockOffset(offset_ns, sigma_ns, (SWEEPS,))


def _lag(bag: Bag, calibration: Path, options: SynchroniseOptions) -> SweepLag | None:
    rig, _ = read_calibration(calibration, bag)
    sequence, sweeps = unjoined_sequence(bag, rig, options, sequence_name(bag.path))
    return measured_lag(sequence, SweepsOfOpenBag(sweeps, bag))


# A recording's clock offset, measured from the robot's motion as seen by its sensors. Cameras give rotations of
# pictures, then the phase of their triggers; radars give Doppler; gyros give rotations. Each kind is compared with the
# track of the reference, and consistent results are averaged with weights by their errors. An offset is added to the
# recording's times. A camera that fires when the LiDAR faces its way gives the offset within a sweep to a fraction of a
# millisecond, and its pictures identify the sweep. Kinds that contradict each other beyond their errors are refused,
# not averaged.


Read = Callable[[Bag, Candidate, RobotMotion], LagEvidence | None]
KINDS: tuple[tuple[str, Role, Read], ...] = (
    (CAMERAS, "camera", camera_turns),
    (RADARS, "radar", radar_speeds),
    (GYRO, "imu", gyro_turns),
)
SEARCHED_S = 10.0
# A larger standard error is not a measurement, and a larger share of a sweep's period does not identify the sweep.
MOST_SIGMA_S, MOST_SIGMA_PERIODS = 0.02, 0.1
SIGMAS, EXPOSURE_S = 5.0, 0.005
# Mounts give a camera's direction to about a degree, which a LiDAR rotates through in this share of its period.
LEAST_TRIGGER_SIGMA_PERIODS = 1 / 360


@dataclass(frozen=True, eq=False)
class RunReference:
    """The reference for offsets: the run from the reference recording alone, and its LiDAR's direction over time."""

    name: str
    sequence: RunSequence
    robot: RobotMotion
    look: LidarRotation | None


def reference_of(bag: Bag, calibration: Path, options: SynchroniseOptions) -> RunReference:
    """Return the reference. Raises: `SYN-523`, and what `read_calibration` and `unjoined_sequence` raise."""
    rig, _ = read_calibration(calibration, bag)
    sequence, sweeps = unjoined_sequence(bag, rig, options, sequence_name(bag.path))
    if sequence.track is None or len(sequence.frames) < 2:
        raise unmeasured_offset([bag.path.name], ["it has too few sweeps with a pose to compare other clocks with"])
    look = lidar_look(bag, sweeps, typical_period_ns(sequence.frames.stamps_ns))
    return RunReference(bag.path.name, sequence, RobotMotion(sequence.track, rig, sequence.max_pose_gap_ns), look)


def measured_offset(bag: Bag, name: str, reference: RunReference) -> ClockOffset:
    """Return the offset of the recording `name`, or of a group with one clock.

    Raises: `SYN-523`, `SYN-524`, and what decoding raises.
    """
    topics = [candidate_of(bag, topic) for topic in bag.topics if topic.count and topic.encoding == "cdr"]
    fits, reasons = dict[str, LagFit](), list[str]()
    for kind, role, read in KINDS:
        own = [topic for topic in topics if topic.role == role]
        fit = _fit(bag, own, (read, reference.robot))
        if fit is not None:
            fits[kind] = fit
        elif own:
            reasons.append(
                f"{len(own)} topics of its {role}s give no clock offset: the robot rotated and accelerated too little"
            )
    if not fits:
        raise unmeasured_offset([name], reasons)
    offset = _average_offsets(name, fits)
    return _trigger_offset(bag, [topic for topic in topics if topic.role == "camera"], reference, offset) or offset


def _fit(bag: Bag, topics: Sequence[Candidate], how: tuple[Read, RobotMotion]) -> LagFit | None:
    read, robot = how
    evidence = list[LagEvidence]()
    for topic in topics:
        with suppress(MessageLayoutError, ByteOrderError, CloudLayoutError, DefinitionMissingError):
            if (lag := read(bag, topic, robot)) is not None:
                evidence.append(lag)
    fit = fitted_lag(evidence, (-SEARCHED_S, SEARCHED_S)) if evidence else None
    return fit if fit is not None and fit.sigma_s <= MOST_SIGMA_S else None


def _average_offsets(name: str, fits_by_kind: dict[str, LagFit]) -> ClockOffset:
    """Return the mean weighted by inverse variance. Raises: `SYN-524`."""
    fits = list(fits_by_kind.values())
    offsets, sigmas = (np.array(column) for column in zip(*((fit.offset_s, fit.sigma_s) for fit in fits), strict=True))
    weights = 1 / sigmas**2
    mean_s = float(np.sum(weights * offsets) / weights.sum())
    if (np.abs(offsets - mean_s) > SIGMAS * sigmas + EXPOSURE_S).any():
        measured = [f"{fit.offset_s:+.4f} ± {fit.sigma_s:.4f} s by {kind}" for kind, fit in fits_by_kind.items()]
        raise IngestError(
            "SYN-524",
            f"the sensors in {name} give different clock offsets: {', '.join(measured)}; is a mount in the "
            f"calibration wrong, or does a sensor use another clock? Set the offset with {OPTION.format(name=name)}",
        )
    return ClockOffset(round(mean_s * 1e9), round(float(weights.sum()) ** -0.5 * 1e9), tuple(fits_by_kind))


def _trigger_offset(
    bag: Bag, cameras: Sequence[Candidate], reference: RunReference, offset: ClockOffset
) -> ClockOffset | None:
    """Return the offset by the phase of cameras that fire when the LiDAR faces their way.

    None if the cameras do not, or if the sweep cannot be identified.
    """
    look, sigma_ns = reference.look, offset.sigma_ns or 0
    if look is None or sigma_ns > MOST_SIGMA_PERIODS * look.period_ns:
        return None
    fired, looks = list[int](), list[int]()
    for topic in cameras:
        recorded = next(candidate for candidate in bag.topics if candidate.name == topic.name)
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


# The arguments of joining recordings, and their checks.


@dataclass(frozen=True)
class JoinRequest:
    """The recordings of one run: files, or folders of split bags, with different names.

    - `given_ns`: offsets by recording name, which are not measured
    - the calibration, file or folder: without it, only offsets that need no mounts are measured
    - `options`: choices of topics as for synchronising
    - `is_in_place`: read as little as possible
    """

    paths: tuple[Path, ...]
    calibration: Path | None = None
    given_ns: Mapping[str, int] = field(default_factory=dict)
    options: SynchroniseOptions = field(default_factory=SynchroniseOptions)
    is_in_place: bool = False

    def opened(self, path: Path) -> Bag:
        """Return one of the recordings, or some of them joined. Raises as `open_bag`."""
        bag = open_bag(path)
        if self.is_in_place:
            bag.read_sparingly()
        return bag

    @property
    def path_of(self) -> Mapping[str, Path]:
        return {path.name: path for path in self.paths}


def checked_paths(request: JoinRequest) -> tuple[Path, ...]:
    """Return the paths sorted by name, independent of their given order. Raises: `SYN-526`."""
    names = sorted(path.name for path in request.paths)
    if not 2 <= len(names) <= MOST_MEMBERS:
        raise not_joined(f"{len(names)} recordings were given, but 2 to {MOST_MEMBERS} can be joined")
    if len({name.casefold() for name in names}) < len(names):
        raise not_joined(f"two of the recordings have the same name: {', '.join(names)}")
    for path in request.paths:
        if not is_member_name(path.name) or is_joined(path):
            raise not_joined(f"{path.name!r} is already a joined recording, or its name is not a valid file name")
    if unknown := sorted(set(request.given_ns) - set(names)):
        raise not_joined(f"an offset is given for {unknown[0]!r}, which is not one of {', '.join(names)}")
    return tuple(sorted(request.paths, key=lambda path: path.name))


def reference_first(held: Sequence[HeldMessages], lidar: str | None) -> tuple[HeldMessages, ...]:
    """Return the recordings, starting with the earliest that has the LiDAR (or the topic `lidar`).

    Raises: `TOP-101`.
    """
    counts: dict[str, int] = {}
    for recording in held:
        for topic in recording.of_role("lidar"):
            counts[topic.name] = counts.get(topic.name, 0) + topic.count
    name = lidar or max(counts, key=lambda candidate: (counts[candidate], candidate), default="")
    having = [candidate for candidate in held if any(topic.name == name for topic in candidate.topics)]
    if not having:
        unread = unread_points(topic for candidate in held for topic in candidate.topics)
        raise no_lidar(not_read(unread) if unread else "")
    reference = min(having, key=lambda candidate: (candidate.start_ns, candidate.name))
    return (reference, *(candidate for candidate in held if candidate is not reference))


def check_given(request: JoinRequest, held: Sequence[HeldMessages]) -> None:
    """Raise `SYN-526` for an offset of the recording with the LiDAR, whose points have their own times."""
    lidars = {topic.name for topic in held[0].of_role("lidar")}
    for number, recording in enumerate(held):
        has_lidar = not number or any(topic.name in lidars for topic in recording.topics)
        if has_lidar and request.given_ns.get(recording.name):
            raise not_joined(f"{recording.name} contains the LiDAR, whose clock is the run's, so its offset is 0")


Held = Sequence[HeldMessages]


def clock_offsets(request: JoinRequest, held: Held) -> tuple[ClockOffset, ...]:
    """Return the offsets in the order of `held`.

    Raises: `SYN-523`, `SYN-524`, `SYN-525`, and what synchronising raises.
    """
    known = _known(request, held)
    if len(known) < len(held):
        known |= _measure_offsets(request, held, known)
    _check_common_time(held, known)
    return tuple(known[number] for number in range(len(held)))


def members_of_run(held: Held, offsets: Sequence[ClockOffset]) -> tuple[JoinedMember, ...]:
    """Return the members for `joined.json`, with these offsets."""
    return tuple(
        JoinedMember(recording.name, to.offset_ns, to.sigma_ns, to.known_by, to.kept_topics, left)
        for recording, to, left in zip(held, offsets, left_out(held, offsets), strict=True)
    )


def _known(request: JoinRequest, held: Held) -> dict[int, ClockOffset]:
    """Return the offsets of recordings linked by messages or topics to the reference, or to a given offset."""
    known = dict(linked(held, 0)) | {0: ClockOffset(0, None, (REFERENCE,))}
    for number, recording in enumerate(held[1:], start=1):
        if recording.name in request.given_ns:
            known[number] = ClockOffset(request.given_ns[recording.name], None, (GIVEN,))
            for other, link in linked(held, number).items():
                known.setdefault(other, link.after(known[number]))
    return known


def _measure_offsets(request: JoinRequest, held: Held, known: Mapping[int, ClockOffset]) -> Mapping[int, ClockOffset]:
    """Return the offsets of the other recordings, measured together for each clock."""
    waiting = [number for number in range(len(held)) if number not in known]
    if request.calibration is None:
        names = [held[number].name for number in waiting]
        raise unmeasured_offset(names, ["no calibration gives the mounts of its sensors"])
    posed = {} if has_poses((held[number] for number in known), request.options) else _with_poses(request, held, known)
    offsets = {number: offset for number, offset in posed.items() if SWEEPS in offset.known_by}
    with _on_one_clock(request, held, {**posed, **known}) as run:
        reference = reference_of(run, request.calibration, request.options)
        for number in waiting:
            if number not in offsets:
                group = linked(held, number)
                with _on_one_clock(request, held, group) as bag:
                    offset = measured_offset(bag, held[number].name, reference)
                offsets |= {other: link.after(offset) for other, link in group.items()}
    return offsets


def _with_poses(request: JoinRequest, held: Held, known: Mapping[int, ClockOffset]) -> dict[int, ClockOffset]:
    """Return the offsets of the recording with the poses and of its group, by sweeps or by GPS time.

    GPS time needs no offset; {} if no recording has poses.
    """
    others = [held[number] for number in range(len(held)) if number not in known]
    posed = best_poses(others)
    if posed is None or request.calibration is None:
        return {}
    group = linked(held, next(number for number, recording in enumerate(held) if recording is posed))
    if bears_gps_time(posed):
        return {number: link.after(ClockOffset(0, None, ())) for number, link in group.items()}

    def open_at(offset: ClockOffset) -> AbstractContextManager[Bag]:
        moved = {number: link.after(offset) for number, link in group.items()}
        return _on_one_clock(request, held, {**moved, **known})

    offset = pose_offset(posed.name, open_at, request.calibration, request.options)
    return {number: link.after(offset) for number, link in group.items()}


@contextmanager
def _on_one_clock(request: JoinRequest, held: Held, offsets: Mapping[int, ClockOffset]) -> Iterator[Bag]:
    """Yield some of the recordings, opened as one."""
    numbers = sorted(offsets)
    if len(numbers) == 1:
        with request.opened(request.path_of[held[numbers[0]].name]) as bag:
            yield bag
        return
    members = members_of_run([held[number] for number in numbers], [offsets[number] for number in numbers])
    folder = PrivateFolder()
    try:
        write_joined(JoinedRecording(tuple(request.path_of[member.name] for member in members), members), folder.path)
        with request.opened(folder.path) as bag:
            yield bag
    finally:
        folder.close()


def _check_common_time(held: Held, offsets: Mapping[int, ClockOffset]) -> None:
    """Raise `SYN-525` for a recording entirely outside the run's time."""
    run = set(linked(held, 0))
    first_ns, last_ns = min(held[number].start_ns for number in run), max(held[number].end_ns for number in run)
    for number in sorted(set(offsets) - run):
        group = linked(held, number)
        start_ns = min(held[other].start_ns + offsets[other].offset_ns for other in group)
        end_ns = max(held[other].end_ns + offsets[other].offset_ns for other in group)
        apart_ns = max(start_ns - last_ns, 0) or min(end_ns - first_ns, 0)
        if apart_ns:
            raise no_common_time(held[number].name, apart_ns / 1e9, held[0].name)


# Joins several recordings of one run: recordings → the recording with the LiDAR → shared messages, continued topics →
# offsets measured by sensors → joined.json. The reference is the recording with the LiDAR, or the first part of a run
# split into several; its clock is the run's. An offset is added to a recording's times. Given offsets are used, others
# are measured, none is guessed. Equal recordings give equal descriptions, in any order.


def join_recordings(request: JoinRequest) -> JoinedRecording:
    """Join the recordings.

    Raises: `SYN-526`, `TOP-101`, `BAG-041`, `SYN-523`, `SYN-524`, `SYN-525`, and what opening and decoding raise.
    """
    request = replace(request, paths=checked_paths(request))
    with ExitStack() as opened:
        held = held_by({path.name: opened.enter_context(request.opened(path)) for path in request.paths})
    check_types((topic.name, topic.type) for recording in held for topic in recording.topics)
    held = reference_first(held, request.options.lidar_topic or request.options.topics.get("lidar"))
    check_given(request, held)
    members = members_of_run(held, clock_offsets(request, held))
    return JoinedRecording(tuple(request.path_of[member.name] for member in members), members)


def not_joined(problem: str) -> IngestError:
    return IngestError(
        "SYN-526", f"{problem}; name each recording of the run once, including the recording with the LiDAR"
    )
