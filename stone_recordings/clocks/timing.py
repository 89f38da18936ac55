"""Timing of a topic's messages: stamps, period, gaps and steps back.

**Conventions.** A stamp is that of the header if the type starts with one (the first eight bytes of the body) and it is
set, otherwise the log time. A gap is an interval longer than `GAP_RATIO` median periods, so that one lost message of a
jittery topic is no gap and two always are. Only periodic topics have gaps. Topics with bursts (a log, events, a radar's
lists) are not periodic: their rate is their count over their time, not the rate within a burst. If a topic of no sensor
is one short burst (a node's log at its start), its rate is its count over the time of the recording.
"""

from dataclasses import asdict, dataclass
from struct import Struct

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.errors import DefinitionMissingError, MessageLayoutError
from stone_recordings.bags.message_store import Topic
from stone_recordings.messages.types.cdr import HEAD_BYTES, NS_PER_S, check_encapsulation
from stone_recordings.messages.types.registry import message_definition

GAP_RATIO = 2.5
# A topic is periodic if at least half of its intervals are within a half of the median.
STEADY_SHARE, STEADY_RATIO = 0.5, 0.5
LEAST_STEADY_COUNT = 4
# No sensor samples faster: such intervals are those of a burst.
MOST_RATE_HZ = 10_000.0
# The least share of the time that steady intervals cover; less for a sensor by its own stamps, which may be silent for
# most of a recording.
STEADY_COVER, STEADY_SENSOR_COVER = 0.5, 0.03
# One burst lasts at most this share of the recording.
BURST_COVER = 0.1
# Messages are counted as lost only if the period is as strict as a trigger's.
STRICT_RATIO = 0.1

_HEADERS = ("std_msgs/Header ", "std_msgs/msg/Header ", "Header ")
_STAMP = Struct("<iI")


@dataclass(frozen=True)
class Gap:
    """From the last message before to the first one after; half-open in time."""

    start_ns: int
    end_ns: int
    duration_ns: int

    def as_record(self) -> dict[str, int]:
        return asdict(self)


@dataclass(frozen=True, eq=False)
class Timing:
    """For one topic: `stamps_ns` (N,) in log order, and `has_header`, whether they are the sensor's or the recorder's.

    `repeats` counts the messages whose stamp occurs more than once.
    """

    stamps_ns: NDArray[np.int64]
    has_header: bool
    rate_hz: float | None
    gaps: tuple[Gap, ...]
    steps_back_ns: NDArray[np.int64]
    repeats: int = 0


def measure(stamps_ns: NDArray[np.int64], has_header: bool, *, is_sensor: bool = True, recorded_ns: int = 0) -> Timing:
    """Return rate, gaps and steps back of stamps in log order; `recorded_ns` is the time of the whole recording.

    The rate is that of the median period; for an aperiodic topic the count over its time. It is None below two stamps,
    and above the rate of any sensor.
    """
    steps_ns = np.diff(stamps_ns)
    ordered = np.sort(stamps_ns)
    periods_ns = np.diff(ordered)
    is_burst = not is_sensor and len(periods_ns) > 0 and periods_ns.sum() < BURST_COVER * recorded_ns
    is_steady = not is_burst and _is_steady(
        periods_ns, STEADY_SENSOR_COVER if has_header and is_sensor else STEADY_COVER
    )
    period_ns = 0.0 if not len(periods_ns) else float(np.median(periods_ns) if is_steady else np.mean(periods_ns))
    period_ns = recorded_ns / len(stamps_ns) if is_burst else period_ns
    rate_hz = NS_PER_S / period_ns if period_ns * MOST_RATE_HZ >= NS_PER_S else None
    gaps = _gaps(ordered, periods_ns) if is_steady and rate_hz is not None else ()
    return Timing(stamps_ns, has_header, rate_hz, gaps, -steps_ns[steps_ns < 0], int((periods_ns == 0).sum()))


def lost_messages(timing: Timing) -> int:
    """Return the periods without a message, if nine of ten intervals are whole periods within a tenth of one; else
    0.
    """
    periods_ns = np.diff(np.sort(timing.stamps_ns)).astype(np.float64)
    if len(timing.stamps_ns) < LEAST_STEADY_COUNT or timing.rate_hz is None:
        return 0
    beats = periods_ns * timing.rate_hz / NS_PER_S
    whole = np.rint(beats)
    is_strict = float(np.mean(np.abs(beats - whole) <= STRICT_RATIO)) >= 1 - STRICT_RATIO
    return int(np.maximum(whole - 1, 0).sum()) if is_strict else 0


def begins_with_header(topic: Topic) -> bool:
    """Return whether a type starts with a header, by the embedded or the registry's definition; False for unknown
    types.
    """
    text = topic.schema
    if not text:
        try:
            text = message_definition(topic.type)
        except DefinitionMissingError:
            return False
    lines = (line.split("#")[0].strip() for line in text.splitlines())
    return next((line for line in lines if line), "").startswith(_HEADERS)


def stamp_of(payload: memoryview, type_name: str) -> int:
    """Return the header stamp of a message. Raises: MessageLayoutError, ByteOrderError."""
    check_encapsulation(payload, type_name)
    if len(payload) < HEAD_BYTES + _STAMP.size:
        raise MessageLayoutError(type_name, f"{len(payload)} bytes hold no header")
    sec, nanosec = _STAMP.unpack_from(payload, HEAD_BYTES)
    return int(sec) * NS_PER_S + int(nanosec)


def _is_steady(periods_ns: NDArray[np.int64], least_cover: float) -> bool:
    """Return whether intervals in ascending order of time are periodic."""
    if len(periods_ns) + 1 < LEAST_STEADY_COUNT:
        return False
    median_ns, duration_ns = float(np.median(periods_ns)), float(periods_ns.sum())
    is_near = np.abs(periods_ns - median_ns) <= STEADY_RATIO * median_ns
    covers = float(periods_ns[is_near].sum()) >= least_cover * duration_ns
    return bool(duration_ns > 0 and is_near.mean() >= STEADY_SHARE and covers)


def _gaps(ordered_ns: NDArray[np.int64], periods_ns: NDArray[np.int64]) -> tuple[Gap, ...]:
    rows = np.flatnonzero(periods_ns > GAP_RATIO * float(np.median(periods_ns)))
    return tuple(Gap(int(ordered_ns[row]), int(ordered_ns[row + 1]), int(periods_ns[row])) for row in rows)
