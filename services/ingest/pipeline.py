"""From one recording and its calibration to a synchronised sequence: the page to read first.

    topics → stamps → ego trajectory → frames → associations → sweeps on demand

**Conventions.** The LiDAR stamp is the frame (paper, III-C). Nothing is shifted, extrapolated or repaired silently:
what was noticed is in the sequence's findings, what is unusable in its exclusions, the rest is refused.
"""

from dataclasses import dataclass, replace
from pathlib import Path

from services.ingest.bag import open_bag
from services.ingest.ego_track import ego_track, recorded_rig
from services.ingest.extrinsics import cross_check
from services.ingest.fingerprint import recording_sha256
from services.ingest.lidar_clock import lidar_clock
from services.ingest.recorded import read_recorded
from services.ingest.sources import choose_sources
from services.ingest.sweeps import BagSweeps
from services.ingest.synchronisation import associate, frames_with_pose, usable_finding
from stone.calibration import Calibration
from stone.deskew import SweepMount
from stone.sequence import Sequence
from stone.trajectory import DEFAULT_MAX_GAP_NS


@dataclass(frozen=True)
class SynchroniseOptions:
    """Topics by name where the recording's roles are not meant; poses more than `max_pose_gap_ns` apart are a gap.

    `recording_sha256` spares reading the whole recording again where it is known.
    """

    odometry_topic: str | None = None
    lidar_topic: str | None = None
    max_pose_gap_ns: int = DEFAULT_MAX_GAP_NS
    recording_sha256: str | None = None


def synchronise(
    bag_path: Path, calibration: Calibration, options: SynchroniseOptions, name: str
) -> tuple[Sequence, BagSweeps]:
    """The sequence called `name`, and where its deskewed sweeps come from.

    Raises what opening and decoding raise (BAG-*, MSG-*), the leaves of `services.ingest.synchronisation_errors`
    (no LiDAR, no pose source, no usable pose, no frame), and MissingSensorError when an INS has no mount.
    """
    with open_bag(bag_path) as bag:
        sources = choose_sources(bag, options.lidar_topic, options.odometry_topic)
        recorded = read_recorded(bag, sources.scanned, sources.whole)
        clock = lidar_clock(bag, recorded, sources.lidar.name)
    rig = recorded_rig(recorded, sources, calibration)
    track = ego_track(recorded, sources, rig)
    posed = frames_with_pose(name, clock, track.trajectory, options.max_pose_gap_ns)
    associations, unmatched = associate(recorded, sources, calibration, posed)
    mounts = cross_check(rig.tree, calibration, rig.lidar_frame)
    sequence = Sequence(
        name=name,
        frames=replace(posed.frames, associations=associations),
        excluded=posed.excluded,
        calibration=calibration,
        pose_source=track.source,
        map_origin_deg_m=track.map_origin_deg_m,
        inputs={bag_path.name: options.recording_sha256 or recording_sha256(bag_path)},
        findings=mounts + clock.findings + track.findings + unmatched + usable_finding(posed),
    )
    motion = SweepMount(track.trajectory, calibration.ego_from_lidar, options.max_pose_gap_ns)
    sweeps = BagSweeps(bag_path, sources.lidar.name, posed.message_index, posed.frames.stamps_ns, motion)
    return sequence, sweeps
