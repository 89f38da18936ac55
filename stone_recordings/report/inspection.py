"""Inspection of a recording without decoding it: topics, roles, rates, gaps, and findings about them.

**Conventions.** Stamps are header stamps if a type has them (`stone_recordings.clocks.timing`). Inspection decodes one
cloud of a cloud topic, and all messages of a NovAtel topic, which are small. An unreadable topic is a finding, not a
failure; an unreadable container is refused.
"""

from collections.abc import Iterator, Sequence, Set
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from stone.errors import StoneError
from stone.findings import Finding
from stone.sensors.ground_plane import GroundFit
from stone_recordings.bags.bag import Bag, Topic, open_bag
from stone_recordings.clocks.findings import clock_findings
from stone_recordings.clocks.measurement import kept_bytes, measured
from stone_recordings.clocks.report import ClockReport
from stone_recordings.clocks.timing import Timing, measure
from stone_recordings.messages.camera import IMAGE
from stone_recordings.messages.problems import left_out_finding
from stone_recordings.messages.tf import TransformSamples, decode_transforms
from stone_recordings.messages.types.cdr import Cursor
from stone_recordings.messages.types.definition_checks import definition_findings
from stone_recordings.poses.extrinsics import static_tree
from stone_recordings.poses.recorded_mounts import (
    RecordedRadar,
    direction_findings,
    radar_channels,
    unplaced_finding,
)
from stone_recordings.poses.static_tree import StaticTree
from stone_recordings.report import checks
from stone_recordings.report.head_checks import head_findings, undated_finding
from stone_recordings.report.scan import Scan, scan_of
from stone_recordings.sync.recorded_messages import RecordedReading
from stone_recordings.topics.cloud_samples import packet_findings, sample_cloud
from stone_recordings.topics.profiles import Assignment, Candidate, TopicProfile, resolve
from stone_recordings.topics.roles import Role, TopicFacts, holds_sweeps, role_of
from stone_recordings.topics.sources import AskedTopics, choose_sources

MOST_FRAMES = 64
MOST_STATIC = 1000
NO_STAMPS = np.zeros(0, np.int64)


@dataclass(frozen=True, eq=False)
class InspectedTopic:
    """One topic and the times of its messages; `point_count` is that of one of its clouds.

    `problem` is the reason why none of its messages can be read.
    """

    topic: Topic
    role: Role
    timing: Timing
    point_count: int = 0
    problem: str = ""

    def as_record(self) -> dict[str, object]:
        rate_hz = self.timing.rate_hz
        return {
            "name": self.topic.name,
            "type": self.topic.type,
            "count": self.topic.count,
            "role": self.role,
            "rate_hz": None if rate_hz is None else round(rate_hz, 3),
            "point_count": self.point_count,
            "gaps": [gap.as_record() for gap in self.timing.gaps],
        }


@dataclass(frozen=True, eq=False)
class Inspection:
    """The result of `stone inspect`; `duration_ns` is from the first to the last message in log time.

    `lidar_ground` is the ground in the LiDAR's frame, None if it was not measured.
    """

    duration_ns: int
    topics: tuple[InspectedTopic, ...]
    findings: tuple[Finding, ...]
    clocks: ClockReport = field(default_factory=ClockReport)
    candidates: tuple[Candidate, ...] = ()
    assignment: Assignment = field(default_factory=Assignment)
    lidar_ground: GroundFit | None = None

    def as_record(self) -> dict[str, object]:
        return {
            "duration_ns": self.duration_ns,
            "topics": [topic.as_record() for topic in self.topics],
            "findings": [finding.as_record() for finding in self.findings],
            "clocks": self.clocks.as_record(),
            "channels": dict(self.assignment.channels),
            "lidar_ground": asdict(self.lidar_ground) if self.lidar_ground else None,
        }


def inspect(path: Path, profile: TopicProfile | None = None) -> Inspection:
    """Inspect a recording; `profile` chooses between topics that fit one role.

    Raises: FileNotFoundError and the `BAG-*` refusals of `open_bag`.
    """
    with open_bag(path) as bag:
        return inspect_in(bag, profile)


def scanned(bag: Bag, asked: AskedTopics | None = None) -> Scan:
    """Return the scan for `inspect_in`, which a caller may run in another thread.

    If topics are `asked` for, the same pass reads them for synchronisation, unless synchronisation would refuse them.
    """
    if asked is not None:
        with suppress(StoneError):
            return scan_of(bag, kept_bytes, RecordedReading(bag, choose_sources(bag, asked)))
    return scan_of(bag, kept_bytes)


def inspect_in(bag: Bag, profile: TopicProfile | None = None, scan: Scan | None = None) -> Inspection:
    """Return `inspect` of a recording that the caller has open; raises the same errors except those of opening."""
    scan = scan or scanned(bag)
    findings: list[Finding] = [*checks.container_findings(bag), *definition_findings(bag.topics)]
    for name, problems in sorted(scan.problems.items()):
        findings += left_out_finding(name, problems, scan.stamps_ns[name])
    topics = tuple(_inspected(bag, topic, scan, findings) for topic in bag.topics)
    by_role = [(topic.topic, topic.role, topic.timing) for topic in topics]
    candidates = _candidates(bag, topics)
    tree = _static_tree(bag, topics)
    radars = [RecordedRadar(item.name, item.frame_id) for item in candidates if item.role == "radar" and item.frame_id]
    assignment = resolve(candidates, profile or TopicProfile(), radar_channels(tree, radars))
    chosen = {topic for topic in (profile or TopicProfile()).topics.values()}
    directions = direction_findings(tree, radars)
    findings += [
        *assignment.findings,
        *(item for item in directions if item.topic not in chosen),
        *unplaced_finding(tree),
    ]
    clocks = measured(bag, scan, by_role)
    findings += clock_findings(clocks)
    findings += _head_findings(by_role, scan, {finding.topic for finding in findings if finding.code == "TIM-202"})
    duration_ns = bag.end_ns - bag.start_ns
    return Inspection(duration_ns, topics, tuple(findings), clocks.report, candidates, assignment)


def _static_tree(bag: Bag, topics: Sequence[InspectedTopic]) -> StaticTree:
    """Return the transforms of /tf_static; the outlook names unreadable ones."""
    samples = list[TransformSamples]()
    for topic in topics:
        if topic.role == "tf_static" and topic.topic.count:
            with suppress(StoneError):
                samples += decode_transforms(bag.messages(topic.topic.name, 0, MOST_STATIC))
    return static_tree(samples)


def _head_findings(inspected: Sequence[checks.Inspected], scan: Scan, apart: Set[str]) -> Iterator[Finding]:
    """Yield the findings about heads; topics whose clock is `apart` from the others have theirs already."""
    for topic, role, _timing in inspected:
        if topic.name in scan.counts and topic.count:
            stamps_ns = scan.stamps_ns[topic.name]
            yield from head_findings(topic, role, scan.counts[topic.name], stamps_ns)
            if topic.name not in apart:
                yield from undated_finding(topic, role, stamps_ns)


def _inspected(bag: Bag, topic: Topic, scan: Scan, findings: list[Finding]) -> InspectedTopic:
    """Return the inspected topic; if its stamps are invalid, it is timed by the recorder's clock and reported."""
    stamps_ns = scan.stamps_ns.get(topic.name, NO_STAMPS)
    has_header = bool(stamps_ns.any())
    is_sensor = role_of(TopicFacts(topic.name, topic.type, None)) != "other"
    times_ns, recorded_ns = stamps_ns if has_header else bag.log_times_ns(topic.name), bag.end_ns - bag.start_ns
    timing = measure(times_ns, has_header, is_sensor=is_sensor, recorded_ns=recorded_ns)
    facts = TopicFacts(topic.name, topic.type, timing.rate_hz)
    try:
        if topic.name in scan.refused:
            raise scan.refused[topic.name]
        if holds_sweeps(topic.name, topic.type) and topic.encoding == "cdr" and topic.count:
            facts = _cloud_facts(bag, facts, topic, findings)
        if topic.type == IMAGE and topic.encoding == "cdr" and topic.count:
            findings += checks.picture_findings(bag, topic)
    except StoneError as error:  # the topic is lost; other findings name what labels need and lack then
        findings.append(Finding(error.code, "warning", topic.name, str(error)))
        facts = replace(facts, problem=str(error))
    return InspectedTopic(topic, role_of(facts), timing, facts.point_count, facts.problem)


def _cloud_facts(bag: Bag, facts: TopicFacts, topic: Topic, findings: list[Finding]) -> TopicFacts:
    """Return the facts with those of one cloud from the middle of the recording."""
    cloud = sample_cloud(bag, topic)
    fields = frozenset(cloud.points.dtype.names or ())
    known = replace(facts, point_fields=fields, point_count=len(cloud.points))
    if role_of(known) == "lidar":
        findings += checks.cloud_findings(bag, topic)
        findings += packet_findings(bag, topic)
    return known


def _candidates(bag: Bag, topics: tuple[InspectedTopic, ...]) -> tuple[Candidate, ...]:
    """Return the topics as candidates; for a limited number of cameras and radars with the frame of their first
    message.
    """
    placed = [topic.topic for topic in topics if topic.role in ("camera", "radar") and topic.topic.count]
    frame_ids = {topic.name: frame_id_of(bag, topic) for topic in placed[:MOST_FRAMES]}
    return tuple(
        Candidate(
            part.topic.name,
            part.topic.type,
            part.role,
            part.topic.count,
            part.timing.rate_hz,
            frame_ids.get(part.topic.name, ""),
            part.point_count,
            part.problem if part.role == "other" else "",
        )
        for part in topics
    )


def frame_id_of(bag: Bag, topic: Topic) -> str:
    """Return the frame of a topic's first message, reading only its head: a raw picture has megabytes.

    The frame is "" if the head cannot be read, which the scan reports.
    """
    try:
        head = next((payload for _topic, index, payload in bag.heads([topic.name]) if not index), memoryview(b""))
        cursor = Cursor(head, topic.type)
        cursor.stamp_ns()
        return cursor.text()
    except StoneError:
        return ""


# The stored record of an inspection, like `stone inspect --json` but bounded: a hostile recording may declare a hundred
# thousand topics with endless names. The numbers of omitted entries are recorded.


MOST_TOPICS, MOST_GAPS, MOST_FINDINGS = 300, 20, 200
LONGEST_TEXT = 300


def inspection_record(inspection: Inspection) -> dict[str, Any]:
    """Return `duration_ns`, `topics`, `findings` and the full number of the last two."""
    frame_ids = {candidate.name: candidate.frame_id for candidate in inspection.candidates}
    return {
        "duration_ns": inspection.duration_ns,
        "topics": [_topic(topic, frame_ids.get(topic.topic.name, "")) for topic in inspection.topics[:MOST_TOPICS]],
        "topics_total": len(inspection.topics),
        "findings": [_short(finding.as_record()) for finding in inspection.findings[:MOST_FINDINGS]],
        "findings_total": len(inspection.findings),
        "clocks": _clocks(inspection),
        "channels": _short(dict(islice(inspection.assignment.channels.items(), MOST_TOPICS))),
        "lidar_ground": asdict(inspection.lidar_ground) if inspection.lidar_ground else None,
    }


def _topic(topic: InspectedTopic, frame_id: str) -> dict[str, Any]:
    gaps = [gap.as_record() for gap in topic.timing.gaps[:MOST_GAPS]]
    record = {**topic.as_record(), "frame_id": frame_id}
    return {**_short(record), "gaps": gaps, "gaps_total": len(topic.timing.gaps)}


def _clocks(inspection: Inspection) -> dict[str, Any]:
    lag = inspection.clocks.imu_lag
    return {
        "topics": [_short(clock.as_record()) for clock in inspection.clocks.topics[:MOST_TOPICS]],
        "imu_lag": None if lag is None else _short(lag.as_record()),
    }


def _short(record: dict[str, Any]) -> dict[str, Any]:
    return {name: value[:LONGEST_TEXT] if isinstance(value, str) else value for name, value in record.items()}
