"""From one recording and its calibration to a synchronised sequence. Start reading here.

    topics → stamps → ego trajectory → frames → associations → sweeps on demand → maps joined where the track breaks
           → mount checked against the ground → drift in z followed

**Conventions.** The LiDAR stamp is the frame (paper, III-C). Nothing is shifted, extrapolated or repaired silently:
observations are in the sequence's findings, unusable sweeps in its exclusions, and other faults are refused.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from stone.findings import Finding
from stone.geometry.se3 import SE3
from stone.geometry.trajectory import DEFAULT_MAX_GAP_NS
from stone.sensors.calibration import Calibration
from stone.sensors.deskew import SweepMount
from stone.sensors.ground_plane import GroundFit
from stone.sensors.sequence import Sequence
from stone_files.bag_fingerprint import hashed_meanwhile
from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.clocks.lidar_clock import lidar_clock
from stone_recordings.clocks.triggers import trigger_findings
from stone_recordings.poses.attitude_check import AttitudeInputs, check_attitude
from stone_recordings.poses.ego_track import PoseInputs, ego_track, motion_findings, recorded_rig
from stone_recordings.poses.extrinsics import cross_check
from stone_recordings.poses.file_poses import PoseFile
from stone_recordings.poses.kiss_odometry import Progress, SweepTopic
from stone_recordings.poses.places import check_extent
from stone_recordings.poses.quality import quality_findings
from stone_recordings.poses.recorded_mounts import RecordedRadar, unplaced_finding, with_radars
from stone_recordings.report.projection_checks import projection_findings
from stone_recordings.sync.association import SensorTopics, associate
from stone_recordings.sync.clock_offsets import ClockOffsets, RecordedStamps, shifted_finding, way_out
from stone_recordings.sync.direction_check import direction_findings
from stone_recordings.sync.ground_check import applied_finding, ground_findings, measured_ground, settled
from stone_recordings.sync.ground_looks import SeenWay, seen_along
from stone_recordings.sync.height_check import height_followed
from stone_recordings.sync.lag_check import lag_findings, measured_lag
from stone_recordings.sync.map_joining import joined
from stone_recordings.sync.radar_check import radar_findings
from stone_recordings.sync.recorded_messages import RecordedTopics, read_recorded
from stone_recordings.sync.sweeps import BagSweeps, SweepsOfOpenBag
from stone_recordings.sync.synchronisation import frames_with_pose, sparse_finding, usable_finding
from stone_recordings.topics.cloud_samples import packet_findings
from stone_recordings.topics.sources import AskedTopics, choose_sources

Ground = Literal["given", "auto"]
RADAR, PLACED = "radar", "CAL-439"


def silent(_stage: str, _done: int, _total: int) -> None:
    """Ignore progress; the default callback."""


@dataclass(frozen=True)
class SynchroniseOptions:
    """Options of synchronisation.

    - `max_pose_gap_ns`: a longer interval between poses is a gap
    - `odometry_topic`: a topic, "kiss-icp", or "course:TOPIC"
    - `topics`: the topic of a role (lidar, pose) or of a channel (CAM_FRONT), instead of the recognised one
    - `ground`: "given" by the calibration, or "auto": measure the height of the LiDAR's mount, and a tilt beyond
      terrain's
    - `poses`: a file with the poses, instead of a topic; `poses_frame`: the frame of a topic's poses if it names none
    - `time_offsets_ns`: added to the stamps of "lidar" and "pose", instead of the calibration's offsets
    - `recording_sha256`: known hash, which saves reading the whole recording again
    - `is_hashed`: if False, the recording is not hashed, and the sequence's `inputs` lack the hash
    - `is_checked`: if False, the findings lack those of `late_findings`
    - `recorded`: messages already read for the same sources
    - `base_from_lidar`: the LiDAR's pose in the poses' base, if the calibration has another ego frame
    """

    odometry_topic: str | None = None
    lidar_topic: str | None = None
    max_pose_gap_ns: int = DEFAULT_MAX_GAP_NS
    recording_sha256: str | None = None
    is_hashed: bool = True
    is_checked: bool = True
    topics: Mapping[str, str] = field(default_factory=dict)
    ground: Ground = "given"
    time_offsets_ns: Mapping[str, int] = field(default_factory=dict)
    poses: PoseFile | None = None
    poses_frame: str = ""
    recorded: RecordedTopics | None = None
    base_from_lidar: SE3 | None = None
    progress: Progress = silent

    @property
    def asked_topics(self) -> AskedTopics:
        """The requested topics; topics given by name take precedence over the profile's."""
        named = {"lidar": self.lidar_topic, "pose": self.odometry_topic}
        given = {role: topic for role, topic in named.items() if topic}
        return AskedTopics.of_roles({**self.topics, **given}, has_pose_file=self.poses is not None)


def synchronise(
    bag_path: Path, calibration: Calibration, options: SynchroniseOptions, name: str
) -> tuple[Sequence, BagSweeps]:
    """Return the sequence called `name`, and the source of its deskewed sweeps.

    Raises what opening and decoding raise (BAG-*, MSG-*), the errors of `stone_recordings.sync.errors` (no LiDAR, no
    pose source, no usable pose, no frame), and MissingSensorError if an INS has no mount.
    """
    with open_bag(bag_path) as bag:
        return synchronise_in(bag, calibration, options, name)


def synchronise_in(
    bag: Bag, calibration: Calibration, options: SynchroniseOptions, name: str
) -> tuple[Sequence, BagSweeps]:
    """As `synchronise`, for an open recording. Raises the same, except errors of opening."""
    if not options.is_hashed:
        return _checked(bag, calibration, options, name)
    with hashed_meanwhile(bag.path, options.recording_sha256) as inputs:
        sequence, sweeps = _checked(bag, calibration, options, name)
        return replace(sequence, inputs={**sequence.inputs, **inputs()}), sweeps


def _checked(bag: Bag, calibration: Calibration, options: SynchroniseOptions, name: str) -> tuple[Sequence, BagSweeps]:
    """Return the sequence without the hash of the recording."""
    sequence, sweeps = _with_ground(bag, calibration, options, name)
    if not options.is_checked:
        return sequence, sweeps
    return replace(sequence, findings=(*sequence.findings, *late_findings(bag, sequence, sweeps))), sweeps


def late_findings(bag: Bag, sequence: Sequence, sweeps: BagSweeps) -> tuple[Finding, ...]:
    """Return the findings of pictures and registered sweeps, which do not change the sequence itself."""
    seen = projection_findings(bag, sequence, sweeps)
    seen += trigger_findings(bag, _without_refuted(sequence, seen), sweeps)
    return seen + lag_findings(measured_lag(sequence, SweepsOfOpenBag(sweeps, bag)))


def _with_ground(
    bag: Bag, calibration: Calibration, options: SynchroniseOptions, name: str
) -> tuple[Sequence, BagSweeps]:
    """Return the sequence with measured ground, drift in z followed, and the LiDAR's mount corrected on request."""
    (sequence, sweeps), applied = _synchronise_messages(bag, calibration, options, name), tuple[Finding, ...]()
    seen, fit = _ground(bag, sequence, sweeps)
    if options.ground == "auto" and fit is not None:
        options = replace(options, base_from_lidar=calibration.ego_from_lidar)
        settled_on = settled(sequence, SweepsOfOpenBag(sweeps, bag), fit)
        turned = _synchronise_messages(bag, settled_on, options, name)
        seen, again = _ground(bag, *turned)
        if again is not None and again.is_way_tilted and not (fit.is_mount_tilted or fit.is_way_tilted):
            # The map was right, and the poses, which are of the ego frame, did not rotate with the LiDAR.
            settled_on = settled(sequence, SweepsOfOpenBag(sweeps, bag), fit.untilted())
            turned = _synchronise_messages(bag, settled_on, options, name)
            seen, again = _ground(bag, *turned)
        placed = tuple(finding for finding in sequence.findings if finding.code == PLACED)
        applied = (*placed, applied_finding(fit, settled_on))
        (sequence, sweeps), fit = turned, again
    doubts = (*ground_findings(sequence, fit), *direction_findings(sequence, fit))
    findings = (*sequence.findings, *applied, *doubts)
    measured = replace(sequence, ground=fit, findings=findings)
    return height_followed(measured, SweepsOfOpenBag(sweeps, bag), fit, seen), sweeps


def _ground(bag: Bag, sequence: Sequence, sweeps: BagSweeps) -> tuple[SeenWay, GroundFit | None]:
    """Return the ground in sweeps along the track, and its pose in the ego frame."""
    opened = SweepsOfOpenBag(sweeps, bag)
    seen = seen_along(sequence, opened)
    return seen, measured_ground(sequence, opened, seen)


def _without_refuted(sequence: Sequence, seen: tuple[Finding, ...]) -> Sequence:
    """Remove trigger findings of cameras with a wrong mount, which cannot give the trigger time."""
    refuted = {finding.topic for finding in seen if finding.code == "CAL-404"}
    mounts = tuple(mount for mount in sequence.calibration.mounts if mount.name not in refuted)
    return replace(sequence, calibration=replace(sequence.calibration, mounts=mounts))


def _synchronise_messages(
    bag: Bag, calibration: Calibration, options: SynchroniseOptions, name: str
) -> tuple[Sequence, BagSweeps]:
    """Return the sequence without the cameras' checks, which read frames."""
    sequence, sweeps = unjoined_sequence(bag, calibration, options, name)
    return joined(sequence, SweepsOfOpenBag(sweeps, bag)), sweeps


def unjoined_sequence(
    bag: Bag, calibration: Calibration, options: SynchroniseOptions, name: str
) -> tuple[Sequence, BagSweeps]:
    """Return the sequence from messages only; each part of a broken track has its own map.

    Raises as `synchronise_in`.
    """
    sources = choose_sources(bag, options.asked_topics)
    known = options.recorded
    recorded = known if known is not None and known.sources == sources else read_recorded(bag, sources)
    clocks = ClockOffsets(options.time_offsets_ns)
    late_ns = clocks.of_lidar(calibration, recorded.frame_id(sources.lidar.name))
    clock = lidar_clock(bag, recorded, sources.lidar.name, late_ns)
    rig = recorded_rig(recorded, sources, calibration, clocks)
    rig = replace(rig, posed_frame=options.poses_frame, base_from_lidar=options.base_from_lidar)
    rig = replace(rig, is_course=sources.is_course)
    channel_of = {topic: channel for channel, topic in options.topics.items()}
    radars = [
        RecordedRadar(source.name, recorded.frame_id(source.name))
        for source, role in sources.associated
        if role == RADAR
    ]
    calibration, placed = with_radars(calibration, rig.tree, radars, channel_of)
    track = ego_track(PoseInputs(bag, recorded, sources, clock, options.poses), rig, options.progress)
    moved = motion_findings(track, SweepTopic(bag, clock), calibration)
    turns = sources.attitude.name if sources.attitude is not None else ""
    check_attitude(track, AttitudeInputs(bag, clock, turns), rig)
    swept = RecordedStamps(clock.ordered.stamps_ns, bag.log_times_ns(clock.topic))
    posed_ns = track.trajectory.stamps_ns
    stamps = RecordedStamps(posed_ns, bag.log_times_ns(track.topic) if track.topic in recorded.topics else posed_ns[:0])
    posed = frames_with_pose(name, clock, track, options.max_pose_gap_ns, lambda: way_out(swept, stamps, clocks))
    check_extent(track.source, posed.frames.map_from_ego.translation_m)
    frames, unmatched = associate(SensorTopics(recorded, sources, calibration, channel_of), posed)
    doubts = quality_findings(track.topic, frames.quality, track.solution, posed.path)
    mounts = (*unplaced_finding(rig.tree), *cross_check(rig.tree, rig.calibration, rig.lidar_frame), *placed)
    scans = radar_findings(bag, recorded, tuple(radar.topic for radar in radars))
    timed = shifted_finding(clock.topic, late_ns) + clock.findings
    sequence = Sequence(
        name=name,
        frames=frames,
        excluded=posed.excluded,
        calibration=calibration,
        pose_source=track.source,
        map_origin_deg_m=track.map_origin_deg_m,
        findings=(
            *(bag.findings + bag.damage_findings + rig.findings + mounts + timed),
            *(track.findings + moved + sparse_finding(track, options.max_pose_gap_ns)),
            *(doubts + unmatched + scans + usable_finding(posed) + packet_findings(bag, sources.lidar)),
        ),
        inputs=track.inputs,
        recordings=bag.recordings,
        track=posed.path,
        max_pose_gap_ns=options.max_pose_gap_ns,
    )
    motion = SweepMount(posed.path, calibration.ego_from_lidar, options.max_pose_gap_ns)
    return sequence, BagSweeps(bag.path, clock.topic, posed.message_index, frames.stamps_ns, motion)
