"""Findings about the clocks of a recording, from its clock report.

**Conventions.** A clock is compared with the agreement of most topics, so that a finding names the wrong clock, and not
all the others. Nothing is shifted.

- TIM-201 stamped on the host, TIM-202 another clock, TIM-203 steps back, TIM-204 gaps, TIM-206 repeated stamps
- TIM-207 drift, TIM-208 lost triggers, TIM-209 the IMU's lag, TIM-210 a sensor without a valid time
- TIM-212 a jump of the recorder's clock
- elsewhere: TIM-211, no date (`stone_recordings.report.head_checks`), TIM-213, poses and sweeps on different clocks
  (`stone_recordings.sync.lag_check`), TIM-214, a shifted clock (`clock_offsets` beside it), and TIM-205 and CAL-406,
  which need a calibration (`stone_recordings.clocks.triggers`)
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from stone.findings import Finding
from stone_recordings.clocks.constants import SINCE_BOOT, constant_of, shift_advice
from stone_recordings.clocks.host_stamps import GPS_REMEDY, StampLateness, host_stamp_finding, readable_ns
from stone_recordings.clocks.measurement import ClockMeasurement
from stone_recordings.clocks.report import UNCLOCKED_ROLES, ClockReport, ImuLag, TopicClock
from stone_recordings.clocks.timing import Timing, lost_messages
from stone_recordings.topics.roles import POSE_ROLES, Role

# Transport takes milliseconds: a median distance beyond this is another clock.
CLOCK_DISTANCE_NS = 500_000_000
# A clock farther from the recorder's is not a robot's clock that is set.
LAST_TRANSPORT_NS = 5_000_000_000
# A host disciplined by NTP deviates by less, a free quartz by up to 100 ppm.
DRIFT_LIMIT_PPM = 20.0
DRIFT_SIGMAS = 5.0
# No quartz is wrong by a percent: such a rate is that of a replay.
LAST_DRIFT_PPM = 10_000.0
LEAST_AGREEING = 3
LAG_LIMIT_NS, LAG_SIGMAS = 5_000_000, 4


def clock_findings(measured: ClockMeasurement) -> Iterator[Finding]:
    """Yield all findings about clocks of an inspection."""
    yield from measured.findings
    for topic, role, timing in measured.inspected:
        yield from _sequence_findings(topic.name, role, timing)
    for clock in measured.report.topics:
        yield from _host_findings(clock)
        yield from _unsynchronised(clock, measured)
    yield from distance_findings(measured.report)
    yield from drift_findings(measured.report)
    if measured.report.imu_lag is not None:
        yield from _lag_findings(measured.report.imu_lag)


def _sequence_findings(topic: str, role: Role, timing: Timing) -> Iterator[Finding]:
    """Yield findings about stamps out of order, repeated, and missing."""
    if len(timing.steps_back_ns) and timing.has_header:
        worst_s = timing.steps_back_ns.max() / 1e9
        message = f"{len(timing.steps_back_ns)} stamps go backwards (worst by {worst_s:.6f} s)."
        yield Finding("TIM-203", "warning", topic, message)
    if role in UNCLOCKED_ROLES and role != "other":
        return
    if timing.repeats and timing.has_header and role != "other":
        message = f"{timing.repeats} of {len(timing.stamps_ns)} messages repeat a stamp; the first of each is used."
        yield Finding("TIM-206", "warning", topic, message)
    if timing.gaps:
        yield _gap_finding(topic, timing)
    if role == "camera" and (lost := lost_messages(timing)):
        expected = len(timing.stamps_ns) + lost
        message = f"{lost} of {expected} triggers gave no image: dropped at {timing.rate_hz or 0:.2f} Hz."
        yield Finding("TIM-208", "warning", topic, message)


def _gap_finding(topic: str, timing: Timing) -> Finding:
    worst = max(timing.gaps, key=lambda gap: gap.duration_ns)
    message = (
        f"{len(timing.gaps)} gap{'s' * (len(timing.gaps) > 1)} at a rate of {timing.rate_hz:.2f} Hz, "
        f"the longest of {worst.duration_ns / 1e9:.3f} s at {worst.start_ns} ns."
    )
    return Finding("TIM-204", "warning", topic, message)


def _host_findings(clock: TopicClock) -> Iterator[Finding]:
    if clock.stamp_source != "host" or clock.role in UNCLOCKED_ROLES:
        return
    if clock.own_jitter_ns is not None and clock.own_offset_ns is not None:
        is_gps = clock.role in ("ins", "gnss")
        remedy = GPS_REMEDY if is_gps else "Let the driver stamp with the sensor's time"
        yield host_stamp_finding(clock.topic, StampLateness(clock.own_offset_ns, clock.own_jitter_ns), remedy)
    elif clock.role != "odometry":
        message = (
            "Probably stamped on the host: its stamps are as irregular as their publishing "
            f"({readable_ns(clock.offset_ns or 0)} before they were recorded). Let the driver stamp by the sensor."
        )
        yield Finding("TIM-201", "warning", clock.topic, message)


def _unsynchronised(clock: TopicClock, measured: ClockMeasurement) -> Iterator[Finding]:
    own = measured.own_times.get(clock.topic)
    if own is None or own.total == len(own.own_ns):
        return
    message = (
        f"In {own.total - len(own.own_ns)} of {own.total} messages the sensor had no time: it was not synchronised."
    )
    yield Finding("TIM-210", "warning", clock.topic, message)


def distance_findings(report: ClockReport) -> Iterator[Finding]:
    """Yield findings from header clocks, compared through the recorder's clock, which all messages share."""
    compared = {clock.topic: clock for clock in _clocked(report) if clock.offset_ns is not None}
    offsets = {name: clock.offset_ns or 0 for name, clock in compared.items()}
    lidars = [name for name, clock in compared.items() if clock.role == "lidar"]
    if not offsets:
        return
    agreed = _agreeing(offsets, lidars)
    near_ns = [offsets[name] - offsets[agreed[0]] for name in agreed]  # small numbers: floats are exact
    reference_ns = offsets[agreed[0]] + round(float(np.median(near_ns)))
    whose = next((name for name in agreed if name in lidars), agreed[0])
    for name, clock in compared.items():
        if name not in agreed:
            yield _distance(clock, "Its clock", reference_ns - offsets[name], whose, clock.constant)
        own_ns = reference_ns - offsets[name] - (clock.own_offset_ns or 0)
        if clock.role in ("ins", "gnss") and clock.own_offset_ns is not None and abs(own_ns) > CLOCK_DISTANCE_NS:
            yield _distance(clock, "The GPS time in it, which is used,", own_ns, whose, "")


def _distance(clock: TopicClock, what: str, ahead_ns: int, whose: str, constant: str) -> Finding:
    # A topic's constant is relative to the recorder, whose clock may be the wrong one; a count from boot is
    # unambiguous.
    named = constant_of(ahead_ns) or (constant if constant == SINCE_BOOT else "")
    doubt = f" (= {named.replace('-', ' − ')}?)" if named else ""
    message = f"{what} differs from the clock of {whose} by {ahead_ns / 1e9:.3f} s{doubt}."
    part = "lidar" if clock.role == "lidar" else "pose" if clock.role in POSE_ROLES else ""
    advice = shift_advice(part, -ahead_ns)
    return Finding("TIM-202", "warning", clock.topic, f"{message} Nothing was shifted; {advice}.")


def _agreeing(offsets_ns: Mapping[str, int], lidars: Sequence[str]) -> list[str]:
    """Return the topics that share a clock: the largest group, else the recorder's, else the LiDAR's."""
    names, offsets = list(offsets_ns), np.array(list(offsets_ns.values()), np.float64)
    ordered = np.sort(offsets)
    first = np.searchsorted(ordered, offsets - CLOCK_DISTANCE_NS, side="left")
    sizes = np.searchsorted(ordered, offsets + CLOCK_DISTANCE_NS, side="right") - first
    is_lidar = np.isin(names, lidars)
    is_recorders = np.abs(offsets) < LAST_TRANSPORT_NS
    centre = offsets[np.lexsort((is_lidar, is_recorders, sizes))[-1]]
    return [name for name, offset in zip(names, offsets, strict=True) if abs(offset - centre) <= CLOCK_DISTANCE_NS]


def drift_findings(report: ClockReport) -> Iterator[Finding]:
    """Yield findings on clocks that drift against the others' agreement by more than their scatter.

    Odometry has no clock of its own: its computing time grows, and its stamps are those of its input.
    """
    drifts = [clock for clock in _clocked(report) if clock.drift_ppm is not None and clock.role != "odometry"]
    if len(drifts) < 2:
        return
    lidar = [clock for clock in drifts if clock.role == "lidar"]
    agreed_ppm = float(np.median([clock.drift_ppm or 0.0 for clock in drifts]))
    if len(drifts) < LEAST_AGREEING and lidar:
        agreed_ppm = lidar[0].drift_ppm or 0.0
    for clock in drifts:
        apart_ppm = (clock.drift_ppm or 0.0) - agreed_ppm
        is_certain = abs(apart_ppm) > max(DRIFT_LIMIT_PPM, DRIFT_SIGMAS * (clock.drift_sigma_ppm or 0.0))
        if not is_certain or abs(apart_ppm) > LAST_DRIFT_PPM:
            continue
        doubt = ", or its messages came later and later" if apart_ppm < 0 else ""
        message = (
            f"Its clock drifts by {apart_ppm:+.1f} ppm against the other topics' "
            f"({abs(apart_ppm) * 0.06:.2f} ms a minute){doubt}. Nothing was shifted; synchronise it by PTP."
        )
        yield Finding("TIM-207", "warning", clock.topic, message)


def _clocked(report: ClockReport) -> list[TopicClock]:
    return [clock for clock in report.topics if clock.role not in UNCLOCKED_ROLES]


def _lag_findings(lag: ImuLag) -> Iterator[Finding]:
    if abs(lag.lag_ns) <= max(LAG_LIMIT_NS, LAG_SIGMAS * lag.sigma_ns):
        return
    late = "after" if lag.lag_ns > 0 else "before"
    message = (
        f"Its gyro lags: turns are seen {abs(lag.lag_ns) / 1e6:.1f} ± {lag.sigma_ns / 1e6:.1f} ms "
        f"{late} {lag.reference} "
        f"(correlation {lag.correlation:.3f}). Nothing was shifted; set time_offset_ns to {-lag.lag_ns}."
    )
    yield Finding("TIM-209", "warning", lag.topic, message)
