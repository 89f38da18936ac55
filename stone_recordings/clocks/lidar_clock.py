"""Start, end and stamp of every LiDAR sweep.

**Conventions.** A sweep's stamp is its header's. The extent of its points around the stamp is measured, not assumed: a
driver may stamp the start, the middle or the end of a revolution.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stone.errors import Refused
from stone.findings import Finding
from stone.sensors.sequence import ExcludedFrame
from stone_recordings.bags.bag import Bag
from stone_recordings.clocks.point_clock import looks_of
from stone_recordings.clocks.sweep_findings import sweep_findings
from stone_recordings.messages.pointcloud2 import lidar_points
from stone_recordings.messages.problems import OTHER_FRAME, STRAY, MessageProblem, majority
from stone_recordings.messages.sweep_clouds import cloud_at
from stone_recordings.sync.recorded_messages import OrderedStamps, RecordedTopics, in_order

# A stamp that goes back, and is this far from its time by the recorder's clock, is invalid.
LAST_STRAY_NS = 500_000_000


@dataclass(frozen=True, eq=False)
class LidarClock:
    """The sweeps of a topic in time order: declared `points` (N,), and `span_ns` = (first, last) point time, ns.

    `excluded` are the unusable sweeps, each with its reason; they are not among the others. If points have no time,
    `is_timed` is False and the span is (0, 0).
    """

    topic: str
    ordered: OrderedStamps
    points: NDArray[np.int64]
    span_ns: tuple[int, int]
    is_timed: bool
    findings: tuple[Finding, ...]
    excluded: tuple[ExcludedFrame, ...] = ()


def lidar_clock(bag: Bag, recorded: RecordedTopics, topic: str, offset_ns: int = 0) -> LidarClock:
    """Return the clock with `offset_ns` added to every stamp. Raises `SYN-509`."""
    recorded = with_sweep_problems(recorded, topic)
    stamps_ns, usable, problems = (
        recorded.stamps_ns(topic) + offset_ns,
        recorded.usable(topic),
        recorded.problems[topic],
    )
    if not len(usable):
        raise no_usable_sweep(topic, len(stamps_ns), next((problem.reason for problem in problems.values()), ""))
    ordered = in_order(topic, stamps_ns, usable)
    points = np.array([recorded.cloud_size(topic, index) for index in ordered.index.tolist()], np.int64)
    _check_returns(bag, topic, ordered.index[points > 0])
    looks = looks_of(bag, topic, ordered.index[points > 0])
    spans_ns = [look.span_ns for look in looks if look.span_ns is not None]
    span_ns = (min(first for first, _ in spans_ns), max(last for _, last in spans_ns)) if spans_ns else None
    findings = (*ordered.findings, *sweep_findings(bag, topic, looks))
    excluded = tuple(ExcludedFrame(int(stamps_ns[at]), why.code, why.reason) for at, why in sorted(problems.items()))
    findings += _problem_finding(topic, excluded, len(stamps_ns))
    return LidarClock(topic, ordered, points, span_ns or (0, 0), span_ns is not None, findings, excluded)


def with_sweep_problems(recorded: RecordedTopics, topic: str) -> RecordedTopics:
    """Return the topics with the faults that only a comparison of sweeps shows: another frame, a stamp far from the
    others.
    """
    problems = dict(recorded.problems.get(topic, {}))
    usable = recorded.usable(topic).tolist()
    frame_ids = recorded.frame_ids(topic)
    frame_id = majority(frame_ids)
    for index, other in zip(usable, frame_ids, strict=True):
        if other != frame_id:
            problems[index] = MessageProblem(OTHER_FRAME, f"its frame is {other!r}, that of most is {frame_id!r}")
    stray = _stray(
        recorded.stamps_ns(topic), recorded.log_times_ns[topic], [row for row in usable if row not in problems]
    )
    problems |= {index: MessageProblem(STRAY, why) for index, why in stray}
    return replace(recorded, problems={**recorded.problems, topic: problems})


def _stray(
    stamps_ns: NDArray[np.int64], log_times_ns: NDArray[np.int64], usable: list[int]
) -> Iterable[tuple[int, str]]:
    """Yield single sweeps whose stamp goes back and is far from its time by the recorder's clock."""
    stamps_ns, late_ns = stamps_ns[usable], (log_times_ns - stamps_ns)[usable]
    if len(stamps_ns) < 3:
        return
    apart_ns = late_ns - int(np.median(late_ns))
    for position, index in enumerate(usable):
        is_alone = (
            np.abs(np.delete(apart_ns[max(0, position - 1) : position + 2], min(position, 1))).max() <= LAST_STRAY_NS
        )
        if apart_ns[position] > LAST_STRAY_NS and is_alone:
            yield index, f"it is stamped {apart_ns[position] / 1e9:.3f} s before the sweeps around it"


def _problem_finding(topic: str, excluded: tuple[ExcludedFrame, ...], total: int) -> tuple[Finding, ...]:
    """Return MSG-303 for unusable sweeps; the frames list each one."""
    if not excluded:
        return ()
    first = excluded[0]
    sentence = (
        f"{len(excluded)} of {total} sweeps cannot be used and are left out "
        f"(the first at {first.stamp_ns} ns: {first.reason})"
    )
    return (Finding("MSG-303", "warning", topic, sentence),)


def _check_returns(bag: Bag, topic: str, rows: NDArray[np.int64]) -> None:
    """Raise `SYN-509` if no cloud has a return; the first cloud with a return ends the search."""
    clouds = (lidar_points(cloud_at(bag, topic, row), with_ring=False) for row in rows.tolist())
    if len(rows) and not any(len(cloud.points_lidar) for cloud in clouds):
        raise no_usable_sweep(topic, len(rows), "it has points, but none is a return")


def no_usable_sweep(topic: str, count: int, reason: str) -> Refused:
    return Refused(
        "SYN-509", f"{topic}: none of its {count} sweeps can be used (the first: {reason}); check the driver"
    )
