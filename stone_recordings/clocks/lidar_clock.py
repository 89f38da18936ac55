"""Start, end and stamp of every LiDAR sweep.

**Conventions.** A sweep's stamp is its header's. How far its points reach around the stamp is measured, not assumed: a
driver may stamp the start, the middle or the end of a revolution.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone_recordings.bags.bag import Bag
from stone_recordings.messages.pointcloud2 import decode_cloud, lidar_points
from stone_recordings.sync.recorded_messages import OrderedStamps, RecordedTopics, in_order

# The first and the last sweep may be cut short; a few from beginning to end show the true length.
SPAN_SAMPLES = 5


@dataclass(frozen=True, eq=False)
class LidarClock:
    """The sweeps of a topic in time order: declared `points` (N,), and `span_ns` = (first, last) point time, ns.

    `problems` are the sweeps, by their place in this order, that cannot be decoded, and why.
    Where points have no time, `is_timed` is False and the span is (0, 0).
    """

    topic: str
    ordered: OrderedStamps
    points: NDArray[np.int64]
    span_ns: tuple[int, int]
    is_timed: bool
    findings: tuple[Finding, ...]
    problems: Mapping[int, str] = field(default_factory=dict)


def lidar_clock(bag: Bag, recorded: RecordedTopics, topic: str, offset_ns: int = 0) -> LidarClock:
    """The clock with `offset_ns` added to every stamp. Raises what decoding a cloud raises, where none can be."""
    ordered = in_order(topic, recorded.stamps_ns(topic) + offset_ns)
    points = recorded.cloud_sizes(topic)[ordered.index]
    told = recorded.problems.get(topic, {})
    problems = {at: told[index] for at, index in enumerate(ordered.index.tolist()) if index in told}
    is_good = np.ones(len(points), np.bool_)
    is_good[list(problems)] = False
    if problems and not is_good.any():
        decode_cloud(bag.message(topic, int(ordered.index[0])).payload)
    span_ns = _span_ns(bag, topic, ordered.index[(points > 0) & is_good])
    findings = ordered.findings if span_ns is not None else (*ordered.findings, _no_time(topic))
    findings += _problem_finding(topic, ordered, problems)
    return LidarClock(topic, ordered, points, span_ns or (0, 0), span_ns is not None, findings, problems)


def _problem_finding(topic: str, ordered: OrderedStamps, problems: Mapping[int, str]) -> tuple[Finding, ...]:
    """MSG-303 for sweeps that cannot be decoded; the frames say each."""
    if not problems:
        return ()
    first = min(problems)
    stamp_ns = int(ordered.stamps_ns[first])
    sentence = (
        f"{len(problems)} sweeps cannot be decoded and are left out (the first at {stamp_ns} ns: {problems[first]})"
    )
    return (Finding("MSG-303", "warning", topic, sentence),)


def _span_ns(bag: Bag, topic: str, rows: NDArray[np.int64]) -> tuple[int, int] | None:
    """First and last point time around the stamp over a few clouds from beginning to end; None without."""
    picked = rows[np.linspace(0, len(rows) - 1, min(SPAN_SAMPLES, len(rows))).astype(np.int64)]
    clouds = (lidar_points(decode_cloud(bag.message(topic, row).payload)) for row in picked.tolist())
    offsets = [cloud.offset_ns for cloud in clouds if cloud.offset_ns is not None and len(cloud.offset_ns)]
    if not offsets:
        return None
    return min(int(offset_ns.min()) for offset_ns in offsets), max(int(offset_ns.max()) for offset_ns in offsets)


def _no_time(topic: str) -> Finding:
    sentence = "its points carry no time that can be read; sweeps are taken as they are (a turning robot smears them)"
    return Finding("TOP-102", "warning", topic, sentence)
