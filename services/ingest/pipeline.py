"""From one recording and its calibration to a synchronised sequence: the page to read first.

    topics → stamps → ego trajectory → frames → associations → sweeps on demand

**Conventions.** The LiDAR stamp is the frame (paper, III-C). Nothing is shifted, extrapolated or repaired silently:
what was noticed is in the sequence's findings, what is unusable in its exclusions, the rest is refused.
"""

from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.ingest.bag import Bag, open_bag
from services.ingest.extrinsics import cross_check, plain, static_tree
from services.ingest.ins_poses import track_from_ins
from services.ingest.messages.novatel import decode_bestpos
from services.ingest.messages.pointcloud2 import decode_cloud, lidar_points
from services.ingest.messages.tf import decode_transforms
from services.ingest.poses import PoseTrack, Rig, track_from_odometry, track_from_tf
from services.ingest.recorded import Recorded, in_order, read_recorded
from services.ingest.sources import Sources, choose_sources
from services.ingest.sweeps import BagSweeps
from services.ingest.synchronisation import LidarClock, PosedFrames, associate, counted_reasons, frames_with_pose
from stone.calibration import Calibration
from stone.deskew import SweepMount
from stone.findings import Finding
from stone.sequence import Sequence, SweepSource
from stone.trajectory import DEFAULT_MAX_GAP_NS

HASH_BLOCK_BYTES = 1 << 20
# The first and the last sweep may be cut short; a few from beginning to end show the true length.
SPAN_SAMPLES = 5


@dataclass(frozen=True)
class SynchroniseOptions:
    """Topics by name where the recording's roles are not meant; poses more than `max_pose_gap_ns` apart are a gap."""

    odometry_topic: str | None = None
    lidar_topic: str | None = None
    max_pose_gap_ns: int = DEFAULT_MAX_GAP_NS
    is_deskewed: bool = True


def synchronise(
    bag_path: Path, calibration: Calibration, options: SynchroniseOptions, name: str
) -> tuple[Sequence, SweepSource]:
    """The sequence called `name`, and where its sweeps come from.

    Raises what opening and decoding raise (BAG-*, MSG-*), the leaves of `services.ingest.synchronisation_errors`
    (no LiDAR, no pose source, no usable pose, no frame), and MissingSensorError when an INS has no mount.
    """
    with open_bag(bag_path) as bag:
        sources = choose_sources(bag, options.lidar_topic, options.odometry_topic)
        recorded = _read(bag, sources)
        clock = _lidar_clock(bag, recorded, sources, options)
    rig = _rig(recorded, sources, calibration)
    track = _ego_track(recorded, sources, rig)
    posed = frames_with_pose(name, clock, track.trajectory, options.max_pose_gap_ns)
    associations, noticed = associate(recorded, sources, calibration, posed.frames)
    findings = clock.ordered.findings + track.findings + noticed + _usable_finding(posed)
    sequence = Sequence(
        name=name,
        frames=replace(posed.frames, associations=associations),
        excluded=posed.excluded,
        calibration=calibration,
        pose_source=track.source,
        map_origin_deg_m=track.map_origin_deg_m,
        inputs={bag_path.name: recording_sha256(bag_path)},
        findings=cross_check(rig.tree, calibration, rig.lidar_frame) + _unread_time(clock, sources, options) + findings,
    )
    mount = SweepMount(track.trajectory, calibration.ego_from_lidar, options.max_pose_gap_ns)
    is_timed = clock.span_ns != (0, 0)
    return sequence, BagSweeps(
        bag_path, sources.lidar.name, posed.message_index, posed.frames.stamps_ns, mount if is_timed else None
    )


def recording_sha256(path: Path) -> str:
    """sha256 of the file; of a folder, of its files' names and hashes in order of name."""
    if path.is_dir():
        parts = (f"{recording_sha256(file)}  {file.name}\n" for file in sorted(path.iterdir()) if file.is_file())
        return sha256("".join(parts).encode()).hexdigest()
    digest = sha256()
    with path.open("rb") as file:
        while block := file.read(HASH_BLOCK_BYTES):
            digest.update(block)
    return digest.hexdigest()


def _read(bag: Bag, sources: Sources) -> Recorded:
    scanned = (sources.lidar.name, *(topic.name for topic, _ in sources.associated))
    fixes = (sources.fixes.name,) if sources.fixes is not None and sources.pose_role == "ins" else ()
    return read_recorded(bag, scanned, (*sources.tf_static, *fixes, sources.pose.name))


def _lidar_clock(bag: Bag, recorded: Recorded, sources: Sources, options: SynchroniseOptions) -> LidarClock:
    topic = sources.lidar.name
    ordered = in_order(topic, recorded.stamps_ns(topic))
    sizes = recorded.cloud_sizes(topic)[ordered.index]
    span_ns = _sweep_span_ns(bag, topic, ordered.index[sizes > 0]) if options.is_deskewed else (0, 0)
    return LidarClock(ordered, sizes, span_ns)


def _sweep_span_ns(bag: Bag, topic: str, rows: NDArray[np.int64]) -> tuple[int, int]:
    """(first, last) point time around the stamp over a few clouds from beginning to end; (0, 0) without point times."""
    picked = rows[np.linspace(0, len(rows) - 1, min(SPAN_SAMPLES, len(rows))).astype(np.int64)]
    clouds = (lidar_points(decode_cloud(bag.message(topic, row).payload)) for row in picked.tolist())
    offsets = [cloud.offset_ns for cloud in clouds if cloud.offset_ns is not None and len(cloud.offset_ns)]
    if not offsets:
        return 0, 0
    return min(int(offset_ns.min()) for offset_ns in offsets), max(int(offset_ns.max()) for offset_ns in offsets)


def _rig(recorded: Recorded, sources: Sources, calibration: Calibration) -> Rig:
    samples = [pair for topic in sources.tf_static for pair in decode_transforms(recorded.messages[topic])]
    return Rig(calibration, static_tree(samples), plain(recorded.frame_id(sources.lidar.name)))


def _ego_track(recorded: Recorded, sources: Sources, rig: Rig) -> PoseTrack:
    topic, messages = sources.pose.name, recorded.messages[sources.pose.name]
    if sources.pose_role == "ins":
        fixes = decode_bestpos(recorded.messages[sources.fixes.name]) if sources.fixes is not None else None
        return track_from_ins(messages, topic, rig.calibration, fixes)
    return (
        track_from_odometry(messages, topic, rig)
        if sources.pose_role == "odometry"
        else track_from_tf(messages, topic, rig)
    )


def _unread_time(clock: LidarClock, sources: Sources, options: SynchroniseOptions) -> tuple[Finding, ...]:
    if clock.span_ns != (0, 0) or not options.is_deskewed:
        return ()
    sentence = "its points carry no time that can be read; sweeps are taken as they are (a turning robot smears them)"
    return (Finding("TOP-102", "warning", sources.lidar.name, sentence),)


def _usable_finding(posed: PosedFrames) -> tuple[Finding, ...]:
    if not posed.excluded:
        return ()
    total = len(posed.frames) + len(posed.excluded)
    sentence = f"{len(posed.frames)} of {total} sweeps are frames; excluded: {counted_reasons(posed.excluded)}"
    return (Finding("SYN-501", "warning", "", sentence),)
