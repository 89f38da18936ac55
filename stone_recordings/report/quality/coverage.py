"""Coverage of each topic over time: its deliveries and their rate, by the recorder's clock.

**Conventions.** An interval between two messages is covered if it is at most `GAP_RATIO` periods, or at most
`HICCUP_NS`, for which a busy recorder may delay messages. The recording lasts from its first to its last message of any
topic; bins divide it evenly. Sensors start at different times: a silence of `SETTLING_NS` at either end does not count.
"""

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.bag import Bag
from stone_recordings.clocks.timing import GAP_RATIO, LEAST_STEADY_COUNT, Timing
from stone_recordings.messages.types.cdr import NS_PER_S
from stone_recordings.report.inspection import InspectedTopic, Inspection
from stone_recordings.report.quality.facts import Coverage
from stone_recordings.report.quality.sampling import RecordingSpan, span_of
from stone_recordings.topics.roles import Role

COVER_BINS = 80
MOST_RATE_BINS, MESSAGES_A_RATE_BIN = 48, 5
HICCUP_NS, SETTLING_NS = 50_000_000, 1_000_000_000
ROLES: tuple[Role, ...] = (
    "lidar", "camera", "radar", "ins", "gnss", "imu", "odometry", "tf", "tf_static", "camera_info", "other",
)  # fmt: skip
MOST_TOPICS, MOST_GAPS = 100, 20


def coverage_of(bag: Bag, inspection: Inspection) -> tuple[Coverage, ...]:
    """Return the coverage of the topics with messages, in the order of `ROLES`; at most `MOST_TOPICS`."""
    spoken = [topic for topic in inspection.topics if topic.topic.count]
    ordered = sorted(spoken, key=lambda topic: ROLES.index(topic.role))
    span = span_of(bag)
    return tuple(_coverage(bag, topic, span) for topic in ordered[:MOST_TOPICS])


def _coverage(bag: Bag, inspected: InspectedTopic, span: RecordingSpan) -> Coverage:
    topic, rate_hz = inspected.topic, inspected.timing.rate_hz
    times_ns, span_ns = bag.log_times_ns(topic.name) - span.start_ns, span.length_ns
    first_ns, last_ns = int(times_ns[0]), int(times_ns[-1])
    if rate_hz is None or len(times_ns) < LEAST_STEADY_COUNT or span_ns <= 0:
        return Coverage(topic.name, inspected.role, topic.count, rate_hz, first_ns, last_ns, None, (), ())
    longest_ns = max(HICCUP_NS, round(GAP_RATIO * NS_PER_S / rate_hz))
    return Coverage(
        topic.name,
        inspected.role,
        topic.count,
        rate_hz,
        first_ns,
        last_ns,
        covered_ratio(times_ns, span_ns, longest_ns),
        tuple(covered_bins(times_ns, span_ns, longest_ns).tolist()),
        tuple(rates(times_ns, span_ns).tolist()),
        _gaps(inspected.timing, times_ns),
    )


def _gaps(timing: Timing, times_ns: NDArray[np.int64]) -> tuple[tuple[int, int], ...]:
    """Return the longest gaps, in order of time."""
    delay_ns = int(np.median(times_ns - timing.stamps_ns)) if len(timing.stamps_ns) == len(times_ns) else 0
    longest = sorted(timing.gaps, key=lambda gap: (-gap.duration_ns, gap.start_ns))[:MOST_GAPS]
    return tuple(sorted((gap.start_ns + delay_ns, gap.end_ns + delay_ns) for gap in longest))


def covered_ratio(times_ns: NDArray[np.int64], span_ns: int, longest_ns: int) -> float:
    """Return the covered share of [0, span), 0 to 1, without settling; `times_ns` (N,) ascend, N at least 2."""
    steps_ns = np.diff(times_ns)
    first_ns, last_ns = int(times_ns[0]), int(times_ns[-1])
    head_ns = first_ns if first_ns > SETTLING_NS else 0
    tail_ns = span_ns - last_ns if span_ns - last_ns > SETTLING_NS else 0
    meant_ns = last_ns - first_ns + head_ns + tail_ns
    return float(steps_ns[steps_ns <= longest_ns].sum() / meant_ns) if meant_ns > 0 else 0.0


def covered_bins(times_ns: NDArray[np.int64], span_ns: int, longest_ns: int) -> NDArray[np.float64]:
    """Return the covered share (COVER_BINS,) of each bin of [0, span), with settling."""
    steps_ns = np.diff(times_ns)
    so_far_ns = np.concatenate([[0], np.cumsum(np.where(steps_ns <= longest_ns, steps_ns, 0))])
    edges_ns = np.linspace(0.0, span_ns, COVER_BINS + 1)
    at_edges_ns = np.interp(edges_ns, times_ns.astype(np.float64), so_far_ns.astype(np.float64))
    return np.clip(np.diff(at_edges_ns) * COVER_BINS / span_ns, 0.0, 1.0)


def rates(times_ns: NDArray[np.int64], span_ns: int) -> NDArray[np.float64]:
    """Return messages per second in even bins of [0, span), wide enough for a handful each.

    The count grows linearly between two messages, so that bins do not flicker by one message. A bin in which the topic
    started or ended uses only the part with messages.
    """
    count = len(times_ns)
    bins = int(np.clip(count // MESSAGES_A_RATE_BIN, 1, MOST_RATE_BINS))
    edges_ns = np.linspace(0.0, span_ns, bins + 1)
    numbers = np.interp(edges_ns, times_ns.astype(np.float64), np.arange(count, dtype=np.float64))
    rates_hz = np.diff(numbers) * (bins * NS_PER_S / span_ns)
    spoken_ns = np.minimum(edges_ns[1:], float(times_ns[-1])) - np.maximum(edges_ns[:-1], float(times_ns[0]))
    share = np.maximum(spoken_ns * (bins / span_ns), 0.0)
    is_partial = (share > 0.0) & (share < 1.0)  # the topic started or ended within the bin
    return np.asarray(np.where(is_partial, rates_hz / np.where(is_partial, share, 1.0), rates_hz))
