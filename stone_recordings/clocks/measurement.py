"""Measure the clock of every topic of a scanned recording.

**Conventions.** A sensor's own time decides where its messages carry one: stamps that scatter around it by more than
`HOST_JITTER_NS` were made on the host. Otherwise stamps that are irregular, yet follow the recorder's within a few
milliseconds more closely than they follow their own beat, are those of publishing. What cannot be told from a sensor's
is called a sensor's.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from stone.errors import StoneError
from stone.findings import Finding
from stone.sensors.clocks import ClockLine, clock_line, interval_jitter_ns
from stone_recordings.bags.bag import Bag
from stone_recordings.bags.topic import Topic
from stone_recordings.clocks.constants import constant_of
from stone_recordings.clocks.host_stamps import HOST_JITTER_NS, StampLateness, lateness
from stone_recordings.clocks.imu_lag import IMU_BYTES, POSE_BYTES, imu_lag
from stone_recordings.clocks.recorder_jumps import StampedTimes, without_jumps
from stone_recordings.clocks.report import UNCLOCKED_ROLES, ClockReport, StampSource, TopicClock
from stone_recordings.clocks.sensor_times import OWN_TIME_BYTES, OwnTimes, has_own_time, own_times
from stone_recordings.clocks.timing import measure
from stone_recordings.messages.batch import refused_finding
from stone_recordings.messages.odometry import TYPE as ODOMETRY
from stone_recordings.messages.odometry import decode_odometry, other_frames_finding
from stone_recordings.messages.problems import read_readable
from stone_recordings.report.checks import Inspected
from stone_recordings.report.scan import Scan
from stone_recordings.topics.roles import ROLE_OF_TYPE

# From publishing to recording; exposure, transfer and a sweep take longer.
LAST_PUBLISH_DELAY_NS = 5_000_000


@dataclass(frozen=True)
class ClockMeasurement:
    """The report, and what kept parts of it from being measured.

    `inspected` are the topics as they would be timed if the recorder's clock had not jumped.
    """

    report: ClockReport
    findings: tuple[Finding, ...] = ()
    own_times: dict[str, OwnTimes] = field(default_factory=dict)
    inspected: tuple[Inspected, ...] = ()


def kept_bytes(topic: Topic) -> int:
    """How much of each message the scan should copy for `measured`."""
    role = ROLE_OF_TYPE.get(topic.type)
    if role == "imu":
        return IMU_BYTES
    if role in ("ins", "odometry"):
        return POSE_BYTES
    return OWN_TIME_BYTES if has_own_time(topic) else 0


def measured(bag: Bag, scan: Scan, inspected: Sequence[Inspected]) -> ClockMeasurement:
    """A topic whose messages lie is a finding here, never a failure."""
    findings: list[Finding] = []
    own: dict[str, OwnTimes] = {}
    for topic, _role, _timing in inspected:
        if scan.kept.get(topic.name) and has_own_time(topic):
            try:
                own[topic.name], unread = read_readable(topic.name, scan.kept[topic.name], partial(own_times, topic))
                findings += unread
            except StoneError as error:
                findings.append(Finding(error.code, "error", topic.name, str(error)))
        elif scan.kept.get(topic.name) and topic.type == ODOMETRY:
            findings += _pose_findings(topic, scan)
    logged = {topic.name: bag.log_times_ns(topic.name) for topic, _role, _timing in inspected}
    stamped = {
        topic.name: StampedTimes(timing.stamps_ns, logged[topic.name], role not in UNCLOCKED_ROLES)
        for topic, role, timing in inspected
        if timing.has_header
    }
    times, jumps = without_jumps(stamped)
    findings += jumps
    if jumps:
        inspected = [_timed_again(part, times) for part in inspected]
        logged |= {name: one.log_times_ns for name, one in times.items()}
    clocks = tuple(_clock(logged[part[0].name], part, own.get(part[0].name)) for part in inspected)
    try:
        lag = imu_lag(scan, [(topic, role) for topic, role, _timing in inspected])
    except StoneError as error:
        lag = None
        findings.append(Finding(error.code, "warning", "", f"The lag of the IMU cannot be measured: {error}"))
    return ClockMeasurement(ClockReport(clocks, lag), tuple(findings), own, tuple(inspected))


def _timed_again(part: Inspected, times: Mapping[str, StampedTimes]) -> Inspected:
    """A topic in the order in which it was recorded: that of the recorder's times is another where they went back."""
    topic, role, _timing = part
    if topic.name not in times:
        return part
    return topic, role, measure(times[topic.name].stamps_ns, True, is_sensor=role != "other")


def _pose_findings(topic: Topic, scan: Scan) -> list[Finding]:
    """What synchronising will say of its messages that hold no pose."""
    try:
        samples, unread = read_readable(topic.name, scan.kept[topic.name], decode_odometry)
    except StoneError as error:
        return [Finding(error.code, "error", topic.name, str(error))]
    strays = other_frames_finding(topic.name, samples)
    return [*unread, *strays, *refused_finding(topic.name, samples.refused_ns, samples.reason)]


def _clock(log_times_ns: NDArray[np.int64], inspected: Inspected, own: OwnTimes | None) -> TopicClock:
    topic, role, timing = inspected
    line = clock_line(timing.stamps_ns, log_times_ns) if timing.has_header else None
    late = lateness(own.late_ns) if own is not None else None
    steps_ns = timing.steps_back_ns if timing.has_header else np.zeros(0, np.int64)
    return TopicClock(
        topic=topic.name,
        role=role,
        count=topic.count,
        rate_hz=timing.rate_hz,
        stamp_source="recorder" if line is None else _source(timing.stamps_ns, line, late),
        offset_ns=None if line is None else line.offset_ns,
        drift_ppm=None if line is None else line.drift_ppm,
        drift_sigma_ppm=None if line is None else line.drift_sigma_ppm,
        jitter_ns=None if line is None else line.jitter_ns,
        constant="" if line is None else constant_of(-line.offset_ns, int(np.median(timing.stamps_ns))),
        gaps=len(timing.gaps),
        steps_back=len(steps_ns),
        worst_step_back_ns=int(steps_ns.max(initial=0)),
        repeats=timing.repeats if timing.has_header else 0,
        own_offset_ns=None if late is None else late.offset_ns,
        own_jitter_ns=None if late is None else late.jitter_ns,
    )


def _source(stamps_ns: NDArray[np.int64], line: ClockLine, late: StampLateness | None) -> StampSource:
    if late is not None:
        return "host" if late.is_host else "sensor"
    is_prompt = 0 < line.offset_ns < LAST_PUBLISH_DELAY_NS
    beat_ns = interval_jitter_ns(stamps_ns)
    return "host" if is_prompt and beat_ns > HOST_JITTER_NS and line.jitter_ns < beat_ns else "sensor"
