"""Jumps of the recorder's own clock within a recording, as when its host is set by NTP while it records.

**Conventions.** The distance of a message is record time − stamp. A jump of the recorder moves the distances of all
topics by the same amount at the same time while their stamps go on; one of a sensor moves its own, and it is its stamps
that jump. Ahead, it leaves a time at which nothing was recorded; back, one that was recorded twice. What is stamped by
the clock of the recorder's host jumps with it, at one distance throughout. Only the comparison of clocks needs a jump
taken out; stamps that jumped are named. TIM-212.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone_recordings.clocks.constants import TOLERANCE_NS
from stone_recordings.sync.errors import listed

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
    """Of the N messages of a topic in log order: header stamps and record times, both (N,).

    `is_used` says whether anybody reads the stamps.
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
    """The record times as if the recorder's clock had not jumped, in log order again, and a finding for each jump."""
    times, findings = dict(topics), list[Finding]()
    for _ in range(MOST_JUMPS):
        steps = {name: step for name, one in times.items() if (step := _step_of(one)) is not None}
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
    """The topics that were recorded before and after the jump at one distance: their stamps jumped as well."""
    before_ns = max(step.before_ns for step in steps.values())
    after_ns = min(step.after_ns for step in steps.values())
    around = ((before_ns - LASTING_NS, before_ns), (after_ns, after_ns + LASTING_NS))
    others = {name: one for name, one in times.items() if one.is_used and name not in steps}
    return sorted(name for name, one in others.items() if _is_level(one, around, abs(size_ns) / 2))


def _is_level(times: StampedTimes, around: Sequence[tuple[int, int]], limit_ns: float) -> bool:
    """Whether the distance is one in both spans of record times."""
    logs_ns = times.log_times_ns
    spans = [(logs_ns - times.stamps_ns)[(logs_ns >= start) & (logs_ns <= stop)] for start, stop in around]
    return all(len(span) for span in spans) and max(map(np.max, spans)) - min(map(np.min, spans)) < limit_ns


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
    beat_ns = float(np.median(np.diff(stamps_ns)))
    if abs(stamps_ns[row] - stamps_ns[row - 1] - beat_ns) > abs(logs_ns[row] - logs_ns[row - 1] - beat_ns):
        return None  # it is the stamps that jump
    is_after = np.zeros(len(order), np.bool_)
    is_after[order[row:]] = True
    return _Step(size_ns, int(logs_ns[row - 1]), int(logs_ns[row]), is_after)


def _are_one(steps: Mapping[str, _Step], times: Mapping[str, StampedTimes]) -> bool:
    """Whether the steps are one jump of the recorder: of one size at one time; ahead, nothing is recorded within."""
    sizes = [step.size_ns for step in steps.values()]
    size_ns = round(float(np.median(sizes)))
    first_ns = max(step.before_ns for step in steps.values())
    last_ns = min(step.after_ns - size_ns for step in steps.values())
    if max(sizes) - min(sizes) > TOLERANCE_NS or first_ns > last_ns + SPREAD_NS:
        return False
    if size_ns < 0:
        return True
    gap = (first_ns + SPREAD_NS // 4, last_ns + size_ns - SPREAD_NS // 4)
    logged = [one.log_times_ns for one in times.values()]
    return not any(bool(((logs_ns > gap[0]) & (logs_ns < gap[1])).any()) for logs_ns in logged)


def _corrected(times: StampedTimes, step: _Step, size_ns: int) -> StampedTimes:
    logs_ns = times.log_times_ns - np.where(step.is_after, size_ns, 0)
    order = np.argsort(logs_ns, kind="stable")
    return replace(times, stamps_ns=times.stamps_ns[order], log_times_ns=logs_ns[order])
