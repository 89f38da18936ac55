"""The findings of an inspection: each one measured here, each with the number that made it.

**Conventions.** `BAG-*` the container, `TOP-*` which topics there are, `TIM-*` their clocks. Nothing is repaired: a
finding says what later stages will do about it, or what to change before the next recording.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np

from services.ingest.bag import Bag, Topic
from services.ingest.messages.batch import Stamped
from services.ingest.messages.novatel import FixSamples, InsSamples, decode_bestpos, decode_inspva
from services.ingest.messages.pointcloud2 import Cloud, lidar_points
from services.ingest.roles import Role
from services.ingest.scan import KeptMessage, Scan
from services.ingest.timing import Timing
from stone.errors import StoneError
from stone.findings import Finding

Inspected = tuple[Topic, Role, Timing]

PACKET_TYPES = frozenset(
    {
        "hesai_ros_driver/msg/UdpFrame",
        "pandar_msgs/msg/PandarScan",
        "nebula_msgs/msg/NebulaPackets",
        "velodyne_msgs/msg/VelodyneScan",
    }
)
POSE_ROLES: tuple[Role, ...] = ("ins", "odometry", "tf")
SINGLE_ROLES: tuple[Role, ...] = ("lidar", "ins", "odometry")
GPS_TIMED: Mapping[str, Callable[[Iterable[Stamped]], FixSamples | InsSamples]] = {
    "novatel_oem7_msgs/msg/INSPVA": decode_inspva,
    "novatel_oem7_msgs/msg/INSPVAX": decode_inspva,
    "novatel_oem7_msgs/msg/BESTPOS": decode_bestpos,
}
# Stamps of one clock differ from each other by rounding; a host's publish times differ by its scheduling.
HOST_JITTER_NS = 500_000
# Transport takes milliseconds: a median distance beyond this is another clock.
CLOCK_DISTANCE_NS = 500_000_000
KNOWN_DISTANCES = ((37, "TAI − UTC"), (18, "GPS − UTC"), (19, "TAI − GPS"))


def container_findings(bag: Bag) -> Iterator[Finding]:
    if not bag.is_indexed:
        yield Finding(
            "BAG-011", "info", "", "No usable index: the whole file was walked. Record without `fastwrite` to avoid it."
        )
    for topic in bag.topics:
        if topic.encoding != "cdr":
            message = f"Encoded as {topic.encoding!r}, only 'cdr' is read: this topic is left out."
            yield Finding("BAG-014", "warning", topic.name, message)


def cloud_findings(topic: Topic, cloud: Cloud) -> Iterator[Finding]:
    """One cloud of a LiDAR topic, looked at in full."""
    points = lidar_points(cloud)
    if points.offset_ns is None and points.time_meaning == "another clock":
        message = "The times of the points are of another clock than the header stamp: deskew is off."
        yield Finding("TOP-102", "warning", topic.name, message)
    elif points.offset_ns is None:
        message = "The points carry no time: deskew is off, a turning robot smears its sweeps."
        yield Finding("TOP-102", "warning", topic.name, message)


def topic_findings(inspected: Sequence[Inspected]) -> Iterator[Finding]:
    """Roles that nobody fills, and roles that several topics fit."""
    names: dict[Role, list[str]] = {}
    for topic, role, _timing in inspected:
        if topic.count:
            names.setdefault(role, []).append(topic.name)
    if "lidar" not in names:
        packets = [topic.name for topic, _role, _timing in inspected if topic.type in PACKET_TYPES]
        why = f"{packets[0]} holds raw packets: let the driver publish points." if packets else "Labels need one."
        yield Finding("TOP-101", "error", packets[0] if packets else "", f"No LiDAR PointCloud2 found. {why}")
    if not names.keys() & set(POSE_ROLES):
        message = "No source of poses: neither INS, odometry nor /tf. Labels need one."
        yield Finding("TOP-103", "warning", "", message)
    for role in SINGLE_ROLES:
        if len(listed := names.get(role, [])) > 1:
            message = f"{len(listed)} topics fit role {role}: {', '.join(listed)}; choose one."
            yield Finding("TOP-110", "warning", listed[0], message)


def clock_findings(inspected: Sequence[Inspected]) -> Iterator[Finding]:
    """Clocks that step back, and topics that pause."""
    for topic, role, timing in inspected:
        if len(timing.steps_back_ns) and timing.has_header:
            worst_s = timing.steps_back_ns.max() / 1e9
            message = f"{len(timing.steps_back_ns)} stamps go backwards (worst by {worst_s:.6f} s)."
            yield Finding("TIM-203", "warning", topic.name, message)
        if timing.gaps and role not in ("tf", "tf_static"):
            yield _gap_finding(topic, timing)


def _gap_finding(topic: Topic, timing: Timing) -> Finding:
    worst = max(timing.gaps, key=lambda gap: gap.duration_ns)
    message = (
        f"{len(timing.gaps)} gaps at a rate of {timing.rate_hz:.2f} Hz, "
        f"the longest of {worst.duration_ns / 1e9:.3f} s at {worst.start_ns} ns."
    )
    return Finding("TIM-204", "warning", topic.name, message)


def is_compared_to_gps(topic: Topic) -> bool:
    """Types that carry both the receiver's time and a header stamp."""
    return topic.type in GPS_TIMED


def host_stamp_findings(scan: Scan, inspected: Sequence[Inspected]) -> Iterator[Finding]:
    """NovAtel's driver stamps when it publishes; the receiver's own time tells by how much it was late."""
    for topic, _role, _timing in inspected:
        if scan.kept.get(topic.name) and topic.name not in scan.refused:
            yield from _host_stamps(topic, scan.kept[topic.name])


def _host_stamps(topic: Topic, messages: Sequence[KeptMessage]) -> Iterator[Finding]:
    try:
        samples = GPS_TIMED[topic.type](messages)
    except StoneError as error:
        yield Finding(error.code, "error", topic.name, str(error))
        return
    knows_week = samples.gps_stamps_ns > 0
    if not knows_week.any():
        return
    late_ns = (samples.host_stamps_ns - samples.gps_stamps_ns)[knows_week]
    offset_ns = int(np.median(late_ns))
    jitter_ns = float(np.std(late_ns - offset_ns))
    if jitter_ns > HOST_JITTER_NS:
        message = (
            f"Stamped on the host (jitter {jitter_ns / 1e6:.2f} ms). "
            f"GPS time is used instead (median offset {offset_ns / 1e6:.2f} ms)."
        )
        yield Finding("TIM-201", "warning", topic.name, message)


def distance_findings(bag: Bag, inspected: Sequence[Inspected]) -> Iterator[Finding]:
    """Header clocks compared through the one clock that all messages share, the recorder's."""
    distances = {
        topic.name: int(np.median(bag.log_times_ns(topic.name) - np.asarray(timing.stamps_ns)))
        for topic, role, timing in inspected
        if timing.has_header and role not in ("tf", "tf_static", "other")
    }
    lidars = [topic.name for topic, role, _timing in inspected if role == "lidar" and topic.name in distances]
    if not lidars:
        return
    for name, distance_ns in distances.items():
        apart_ns = distances[lidars[0]] - distance_ns
        if abs(apart_ns) > CLOCK_DISTANCE_NS:
            message = f"Its clock differs from that of {lidars[0]} by {apart_ns / 1e9:.3f} s{_known(apart_ns)}."
            yield Finding("TIM-202", "warning", name, f"{message} Nothing was shifted; set time_offset_ns.")


def _known(apart_ns: int) -> str:
    near = [name for seconds, name in KNOWN_DISTANCES if abs(abs(apart_ns) / 1e9 - seconds) < 0.2]
    return f" (= {near[0]}?)" if near else ""
