"""Stamps made on the host: their delay against the sensor's own time, and its irregularity.

**Conventions.** Lateness is stamp − the sensor's own time, of every message that carries both. The offset is its
median, the jitter its robust σ (`stone.sensors.clocks.spread`: 1.4826 × the median absolute deviation). Inspection and
synchronisation report the same numbers in the same sentence.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone.sensors.clocks import spread

# Stamps of one clock differ from each other by rounding; a host's publish times differ by its scheduling.
HOST_JITTER_NS = 500_000
MOST_MILLISECONDS_NS = 500_000_000
GPS_REMEDY = "GPS time is used instead"


@dataclass(frozen=True)
class StampLateness:
    """The delay of stamps against the sensor's own time, and its irregularity."""

    offset_ns: int
    jitter_ns: int

    @property
    def is_host(self) -> bool:
        """Whether the stamps were made by the host's scheduling."""
        return self.jitter_ns > HOST_JITTER_NS


def lateness(late_ns: NDArray[np.int64]) -> StampLateness | None:
    """Return the lateness from stamps (N,) minus the sensor's own times; None for N = 0."""
    if not len(late_ns):
        return None
    return StampLateness(int(np.median(late_ns)), round(spread(late_ns - np.median(late_ns))))


def host_stamp_finding(topic: str, late: StampLateness, remedy: str) -> Finding:
    """Return TIM-201; `remedy` is the correction that was applied, or the one to make."""
    message = (
        f"Stamped on the host (jitter {late.jitter_ns / 1e6:.2f} ms). "
        f"{remedy} (median offset {readable_ns(late.offset_ns)})."
    )
    return Finding("TIM-201", "warning", topic, message)


def readable_ns(duration_ns: int) -> str:
    """Return a duration in milliseconds, beyond half a second in seconds."""
    if abs(duration_ns) < MOST_MILLISECONDS_NS:
        return f"{duration_ns / 1e6:.2f} ms"
    return f"{duration_ns / 1e9:.3f} s"
