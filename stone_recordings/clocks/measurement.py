"""Measure the clock of every topic of a scanned recording.

**Conventions.** If messages carry the sensor's own time, it decides: stamps that scatter around it by more than
`HOST_JITTER_NS` were made on the host. Otherwise irregular stamps are those of publishing if they follow the recorder's
clock within a few milliseconds, and more closely than their own period. All other stamps count as the sensor's.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from stone.errors import StoneError
from stone.findings import Finding
from stone.sensors.clocks import ClockLine, clock_line, interval_jitter_ns
from stone.sensors.gyro_lag import gyro_lag
from stone_recordings.bags.bag import Bag
from stone_recordings.bags.message_store import Topic
from stone_recordings.clocks.constants import TOLERANCE_NS, constant_of
from stone_recordings.clocks.host_stamps import HOST_JITTER_NS, StampLateness, lateness
from stone_recordings.clocks.report import UNCLOCKED_ROLES, ClockReport, ImuLag, StampSource, TopicClock
from stone_recordings.clocks.timing import measure
from stone_recordings.messages.batch import StampedMessage, refused_finding
from stone_recordings.messages.imu import decode_imu
from stone_recordings.messages.novatel import decode_inspva, unix_ns
from stone_recordings.messages.odometry import TYPE as ODOMETRY
from stone_recordings.messages.odometry import decode_odometry, other_frames_finding
from stone_recordings.messages.problems import read_readable
from stone_recordings.messages.types.cdr import Cursor
from stone_recordings.poses.ins_poses import enu_from_body_wxyz
from stone_recordings.report.checks import Inspected
from stone_recordings.report.scan import Scan
from stone_recordings.sync.errors import listed
from stone_recordings.topics.roles import ROLE_OF_TYPE, Role

# The lag of the IMU against the pose source, from the messages that the scan kept of both. Orientations are the INS's,
# at GPS time, else those of odometry at its stamps; the gyro's times are its header stamps. The IMU with the most
# messages is used. Source: design §3.


IMU_BYTES = 512  # an Imu takes 324 bytes and its frame_id
POSE_BYTES = 1536  # an Odometry takes 720 bytes and two names
LAST_ANGLE_DEG = 720.0
# Below this correlation the two hardly show the same turns, and the lag is noise.
LEAST_CORRELATION = 0.8
LAST_SIGMA_NS = 5_000_000

Oriented = tuple[NDArray[np.int64], NDArray[np.float64]]


def imu_lag(scan: Scan, topics: Sequence[tuple[Topic, Role]]) -> ImuLag | None:
    """Return the lag; None without an IMU or a pose source, and if the robot turned too little.

    Raises: MessageLayoutError, ByteOrderError, `MSG-304`, PoseValueError.
    """
    imu = _fullest(scan, topics, "imu")
    source = _fullest(scan, topics, "ins") or _fullest(scan, topics, "odometry")
    if imu is None or source is None:
        return None
    samples = decode_imu(scan.kept[imu.name])
    lag = gyro_lag((samples.stamps_ns, samples.angular_velocity_rad_s), _oriented(source, scan.kept[source.name]))
    if lag is None or lag.correlation < LEAST_CORRELATION or lag.sigma_ns > LAST_SIGMA_NS:
        return None
    return ImuLag(imu.name, source.name, lag.lag_ns, lag.sigma_ns, lag.correlation)


def _fullest(scan: Scan, topics: Sequence[tuple[Topic, Role]], wanted: Role) -> Topic | None:
    """Return the readable topic of this role with the most messages."""
    fitting = [topic for topic, role in topics if role == wanted and scan.kept.get(topic.name)]
    return max(fitting, key=lambda topic: topic.count, default=None)


def _oriented(source: Topic, messages: Sequence[StampedMessage]) -> Oriented:
    """Return stamps and `wxyz` of the source's body; an INS without GPS time is left out."""
    if not source.type.startswith("novatel_oem7_msgs/"):
        odometry = decode_odometry(messages)
        return odometry.stamps_ns, odometry.parent_from_child.wxyz
    ins = decode_inspva(messages)
    angles_deg = np.stack([ins.roll_deg, ins.pitch_deg, ins.azimuth_deg])
    is_told = (ins.gps_stamps_ns > 0) & (np.abs(angles_deg) <= LAST_ANGLE_DEG).all(axis=0)
    return ins.gps_stamps_ns[is_told], enu_from_body_wxyz(*angles_deg[:, is_told])


# The time that a sensor writes into its messages beside the header stamp of its driver. Every NovAtel log starts with
# header and `Oem7Header`: GPS week and milliseconds, week 0 without a fix. An ARS 548 list has seconds and nanoseconds,
# and the status 1 if they are PTP's. Both are at the start, so `OWN_TIME_BYTES` of a message suffice. Sources:
# novatel_oem7_msgs, in which humble and master agree up to the milliseconds; ars548_messages, ARS 548 RDI interface.


OWN_TIME_BYTES = 512
SYNC_OK = 1
_NOVATEL, _ARS548 = "novatel_oem7_msgs/msg/", "ars548_messages/msg/DetectionList"
_Parsed = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class OwnTimes:
    """For the messages with an own time: header stamps and the sensor's own times (UTC), both (N,); `total`
    messages.
    """

    header_ns: NDArray[np.int64]
    own_ns: NDArray[np.int64]
    total: int

    @property
    def late_ns(self) -> NDArray[np.int64]:
        """The delay of the header stamps against the sensor's own times."""
        return self.header_ns - self.own_ns


def has_own_time(topic: Topic) -> bool:
    """Return whether messages of the topic's type carry the sensor's own time."""
    lines = [line.split("#")[0].split() for line in topic.schema.splitlines()]
    fields = [words[0].rpartition("/")[2] for words in lines if words]
    return topic.type == _ARS548 or (topic.type.startswith(_NOVATEL) and fields[1:2] in ([], ["Oem7Header"]))


def own_times(topic: Topic, messages: Sequence[StampedMessage]) -> OwnTimes:
    """Return the times; the first bytes of messages suffice. Raises: MessageLayoutError, ByteOrderError."""
    parse = _ars548 if topic.type == _ARS548 else _novatel
    rows = [parse(Cursor(message.payload, topic.type)) for message in messages]
    values = np.array([row for row in rows if row is not None], np.int64).reshape(-1, 3)
    own_ns = _own_ns(topic, values[:, 1], values[:, 2])
    return OwnTimes(values[:, 0], own_ns, len(messages))


def _own_ns(topic: Topic, whole: NDArray[np.int64], rest: NDArray[np.int64]) -> NDArray[np.int64]:
    return whole * 1_000_000_000 + rest if topic.type == _ARS548 else unix_ns(whole, rest)


def _novatel(cursor: Cursor) -> _Parsed | None:
    """Return header stamp, GPS week, milliseconds of the week."""
    stamp_ns = cursor.stamp_ns()
    cursor.text()
    cursor.text()
    cursor.take(2, 2), cursor.u8(), cursor.u32(), cursor.u8()
    start = cursor.take(2, 2)
    week = int.from_bytes(cursor.payload[start : start + 2], "little")
    milliseconds = cursor.u32()
    return (stamp_ns, week, milliseconds) if week else None


def _ars548(cursor: Cursor) -> _Parsed | None:
    """Return header stamp, the radar's seconds, its nanoseconds."""
    stamp_ns = cursor.stamp_ns()
    cursor.text()
    cursor.take(8, 8), cursor.take(12, 4)
    nanoseconds, seconds, status = cursor.u32(), cursor.u32(), cursor.u8()
    return (stamp_ns, seconds, nanoseconds) if status == SYNC_OK else None


# Jumps of the recorder's own clock within a recording, such as NTP setting the host while it records. The distance of a
# message is record time − stamp. A jump of the recorder moves the distances of all topics equally at the same time
# while their stamps continue. A jump of a sensor moves its own distance and its stamps. A jump ahead leaves an interval
# without records; a jump back records an interval twice. Stamps by the clock of the recorder's host jump with it, at
# one distance throughout. Only the comparison of clocks removes jumps; jumped stamps are reported. TIM-212.

# A smaller jump is transport, or a busy host.
LEAST_JUMP_NS = 500_000_000
LEAST_MESSAGES = 4
# A step must last this long on both sides: a busy host catches up sooner.
LASTING_NS = 2_000_000_000
MOST_JUMPS = 8
# Messages that were published together are recorded within this.
SPREAD_NS = 1_000_000_000

Times = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class StampedTimes:
    """For the N messages of a topic in log order: header stamps and record times, both (N,).

    `is_used` is whether any stage reads the stamps.
    """

    stamps_ns: Times
    log_times_ns: Times
    is_used: bool = True


@dataclass(frozen=True, eq=False)
class _Step:
    """A step of the distance by `size_ns` between record times `before_ns` and `after_ns`; `is_after` (N,)."""

    size_ns: int
    before_ns: int
    after_ns: int
    is_after: NDArray[np.bool_]


def without_jumps(topics: Mapping[str, StampedTimes]) -> tuple[dict[str, StampedTimes], tuple[Finding, ...]]:
    """Return the record times without the recorder's jumps, in log order again, and a finding for each jump."""
    times, findings = dict(topics), list[Finding]()
    for _ in range(MOST_JUMPS):
        steps = {name: step for name, topic_times in times.items() if (step := _step_of(topic_times)) is not None}
        if not steps or not _are_one(steps, times):
            break
        size_ns = round(float(np.median([step.size_ns for step in steps.values()])))
        findings.append(_finding(steps, size_ns, _following(steps, size_ns, times)))
        times |= {name: _corrected(times[name], step, size_ns) for name, step in steps.items()}
    return times, tuple(findings)


def _finding(steps: Mapping[str, _Step], size_ns: int, following: Sequence[str]) -> Finding:
    at_ns = min(step.before_ns for step in steps.values())
    against = listed(sorted(steps))
    message = f"The recorder's clock jumped by {size_ns / 1e9:+.3f} s at {at_ns} ns, against the stamps of {against}. "
    if following:
        message += (
            f"Those of {listed(following)} jump with it: they are stamped by that clock "
            "and no longer agree with the others. "
            "Use sensor stamps, or keep the host's clock steady. "
        )
    return Finding("TIM-212", "warning", "", f"{message}Clocks are compared without the jump.")


def _following(steps: Mapping[str, _Step], size_ns: int, times: Mapping[str, StampedTimes]) -> list[str]:
    """Return the topics with one distance before and after the jump: their stamps jumped as well."""
    before_ns = max(step.before_ns for step in steps.values())
    after_ns = min(step.after_ns for step in steps.values())
    around = ((before_ns - LASTING_NS, before_ns), (after_ns, after_ns + LASTING_NS))
    others = {name: topic_times for name, topic_times in times.items() if topic_times.is_used and name not in steps}
    return sorted(name for name, topic_times in others.items() if _is_level(topic_times, around, abs(size_ns) / 2))


def _is_level(times: StampedTimes, around: Sequence[tuple[int, int]], limit_ns: float) -> bool:
    """Return whether the distance is the same in both spans of record times."""
    logs_ns = times.log_times_ns
    spans = [(logs_ns - times.stamps_ns)[(logs_ns >= start) & (logs_ns <= stop)] for start, stop in around]
    return all(len(span) for span in spans) and max(map(np.max, spans)) - min(map(np.min, spans)) < limit_ns


def _step_of(times: StampedTimes) -> _Step | None:
    """Return the largest lasting step of the distance, in the order of the stamps."""
    if len(times.stamps_ns) < LEAST_MESSAGES:
        return None
    order = np.argsort(times.stamps_ns, kind="stable")
    logs_ns, stamps_ns = times.log_times_ns[order], times.stamps_ns[order]
    distance_ns = logs_ns - stamps_ns
    row = int(np.argmax(np.abs(np.diff(distance_ns)))) + 1
    first, last = np.searchsorted(stamps_ns, (stamps_ns[row - 1] - LASTING_NS, stamps_ns[row] + LASTING_NS + 1))
    before, after = distance_ns[first:row], distance_ns[row:last]
    size_ns = round(float(np.median(after - distance_ns[0]) - np.median(before - distance_ns[0])))
    jump_ns = int(distance_ns[row] - distance_ns[row - 1])
    if abs(size_ns) < LEAST_JUMP_NS or abs(jump_ns - size_ns) > TOLERANCE_NS:
        return None
    beat_ns = float(np.median(np.diff(stamps_ns)))
    if abs(stamps_ns[row] - stamps_ns[row - 1] - beat_ns) > abs(logs_ns[row] - logs_ns[row - 1] - beat_ns):
        return None  # the stamps jump
    is_after = np.zeros(len(order), np.bool_)
    is_after[order[row:]] = True
    return _Step(size_ns, int(logs_ns[row - 1]), int(logs_ns[row]), is_after)


def _are_one(steps: Mapping[str, _Step], times: Mapping[str, StampedTimes]) -> bool:
    """Return whether the steps are one jump of the recorder: equal sizes at one time; ahead, with no records within."""
    sizes = [step.size_ns for step in steps.values()]
    size_ns = round(float(np.median(sizes)))
    first_ns = max(step.before_ns for step in steps.values())
    last_ns = min(step.after_ns - size_ns for step in steps.values())
    if max(sizes) - min(sizes) > TOLERANCE_NS or first_ns > last_ns + SPREAD_NS:
        return False
    if size_ns < 0:
        return True
    gap = (first_ns + SPREAD_NS // 4, last_ns + size_ns - SPREAD_NS // 4)
    logged = [topic_times.log_times_ns for topic_times in times.values()]
    return not any(bool(((logs_ns > gap[0]) & (logs_ns < gap[1])).any()) for logs_ns in logged)


def _corrected(times: StampedTimes, step: _Step, size_ns: int) -> StampedTimes:
    logs_ns = times.log_times_ns - np.where(step.is_after, size_ns, 0)
    order = np.argsort(logs_ns, kind="stable")
    return replace(times, stamps_ns=times.stamps_ns[order], log_times_ns=logs_ns[order])


# The delay from publishing to recording; exposure, transfer and a sweep take longer.
LAST_PUBLISH_DELAY_NS = 5_000_000


@dataclass(frozen=True)
class ClockMeasurement:
    """The report, and the faults that kept parts of it from being measured.

    `inspected` are the topics timed as if the recorder's clock had not jumped.
    """

    report: ClockReport
    findings: tuple[Finding, ...] = ()
    own_times: dict[str, OwnTimes] = field(default_factory=dict)
    inspected: tuple[Inspected, ...] = ()


def kept_bytes(topic: Topic) -> int:
    """Return how many bytes of each message the scan should copy for `measured`."""
    role = ROLE_OF_TYPE.get(topic.type)
    if role == "imu":
        return IMU_BYTES
    if role in ("ins", "odometry"):
        return POSE_BYTES
    return OWN_TIME_BYTES if has_own_time(topic) else 0


def measured(bag: Bag, scan: Scan, inspected: Sequence[Inspected]) -> ClockMeasurement:
    """Measure all clocks; a topic with invalid messages is a finding here, never a failure."""
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
        logged |= {name: topic_times.log_times_ns for name, topic_times in times.items()}
    clocks = tuple(_clock(logged[part[0].name], part, own.get(part[0].name)) for part in inspected)
    try:
        lag = imu_lag(scan, [(topic, role) for topic, role, _timing in inspected])
    except StoneError as error:
        lag = None
        findings.append(Finding(error.code, "warning", "", f"The lag of the IMU cannot be measured: {error}"))
    return ClockMeasurement(ClockReport(clocks, lag), tuple(findings), own, tuple(inspected))


def _timed_again(part: Inspected, times: Mapping[str, StampedTimes]) -> Inspected:
    """Return a topic in the order of recording, which differs from the recorder's times if these went back."""
    topic, role, _timing = part
    if topic.name not in times:
        return part
    return topic, role, measure(times[topic.name].stamps_ns, True, is_sensor=role != "other")


def _pose_findings(topic: Topic, scan: Scan) -> list[Finding]:
    """Return the findings of synchronisation about messages without a pose."""
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
