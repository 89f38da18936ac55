"""Jumps of the recorder's own clock within a recording, as when its host is set by NTP while it records.

**Conventions.** The distance of a message is record time − stamp. A jump of the recorder moves the distances of all
topics by the same amount at the same time; one of a sensor moves its own. Ahead, it leaves a time at which nothing was
recorded; back, one that was recorded twice. Stamps are in nobody's way, so nothing but the comparison of clocks needs
it taken out. TIM-212.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone_recordings.clocks.constants import TOLERANCE_NS

# Less is transport, or a host that is busy.
LEAST_JUMP_NS = 500_000_000
LEAST_MESSAGES = 4
# By so much of the time before and after it a step is told: what a busy host delivers late is on time again soon.
LASTING_NS = 2_000_000_000
MOST_JUMPS = 8
# Messages that were published together are recorded within this.
SPREAD_NS = 1_000_000_000

Times = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class StampedTimes:
    """Of the N messages of a topic in log order: header stamps and record times, both (N,)."""

    stamps_ns: Times
    log_times_ns: Times


@dataclass(frozen=True, eq=False)
class _Step:
    """A step of the distance by `size_ns` between record times `before_ns` and `after_ns`; `is_after` (N,)."""

    size_ns: int
    before_ns: int
    after_ns: int
    is_after: NDArray[np.bool_]


def without_jumps(topics: Mapping[str, StampedTimes]) -> tuple[dict[str, StampedTimes], tuple[Finding, ...]]:
    """The record times as if the recorder's clock had not jumped, in log order again, and a finding for each jump."""
    times, findings = dict(topics), list[Finding]()
    for _ in range(MOST_JUMPS):
        steps = {name: step for name, one in times.items() if (step := _step_of(one)) is not None}
        if not steps or not _are_one(steps, times):
            break
        first = min(steps.values(), key=lambda step: step.before_ns)
        size_ns = round(float(np.median([step.size_ns for step in steps.values()])))
        message = (
            f"The recorder's clock jumped by {size_ns / 1e9:+.3f} s at {first.before_ns} ns, for all "
            f"{len(steps)} topics alike. Stamps are not touched by it, and clocks are compared without it."
        )
        findings.append(Finding("TIM-212", "warning", "", message))
        times |= {name: _corrected(times[name], step, size_ns) for name, step in steps.items()}
    return times, tuple(findings)


def _step_of(times: StampedTimes) -> _Step | None:
    """The largest lasting step of the distance, in the order of the stamps."""
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
    is_after = np.zeros(len(order), np.bool_)
    is_after[order[row:]] = True
    return _Step(size_ns, int(logs_ns[row - 1]), int(logs_ns[row]), is_after)


def _are_one(steps: Mapping[str, _Step], times: Mapping[str, StampedTimes]) -> bool:
    """Whether the steps are one jump of the recorder: of one size at one time, and of every topic that was there."""
    sizes = [step.size_ns for step in steps.values()]
    size_ns = round(float(np.median(sizes)))
    first_ns = max(step.before_ns for step in steps.values())
    last_ns = min(step.after_ns - size_ns for step in steps.values())
    is_alike = max(sizes) - min(sizes) <= TOLERANCE_NS and first_ns <= last_ns + SPREAD_NS
    if not is_alike or (size_ns < 0 and len(steps) < 2):
        return False
    others = [one.log_times_ns for name, one in times.items() if name not in steps and len(one.log_times_ns)]
    if size_ns < 0:
        return all(logs_ns[-1] <= first_ns + SPREAD_NS or logs_ns[0] >= last_ns for logs_ns in others)
    gap = (first_ns + SPREAD_NS // 4, last_ns + size_ns - SPREAD_NS // 4)
    logged = [one.log_times_ns for one in times.values()]
    return not any(bool(((logs_ns > gap[0]) & (logs_ns < gap[1])).any()) for logs_ns in logged)


def _corrected(times: StampedTimes, step: _Step, size_ns: int) -> StampedTimes:
    logs_ns = times.log_times_ns - np.where(step.is_after, size_ns, 0)
    order = np.argsort(logs_ns, kind="stable")
    return replace(times, stamps_ns=times.stamps_ns[order], log_times_ns=logs_ns[order])
