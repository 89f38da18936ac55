"""The clock report: the clock of each topic's stamps, and the delay of the gyro against the pose source.

**Conventions.** A topic's stamps come from the sensor, from the host that published them, or, if messages carry none,
from the recorder. `offset_ns` is the median of record time − stamp; `drift_ppm` is positive for a stamping clock that
runs fast against the recorder's. None means unknown, never 0. Nothing here shifts a stamp.
"""

from dataclasses import asdict, dataclass
from typing import Literal

from stone_recordings.topics.roles import Role

# No stage reads the stamps of these roles.
UNCLOCKED_ROLES: tuple[Role, ...] = ("tf", "tf_static", "camera_info", "other")
StampSource = Literal["sensor", "host", "recorder"]


@dataclass(frozen=True)
class TopicClock:
    """`jitter_ns` is 1.4826 times the median absolute deviation of record time − stamp from its line.

    `constant` names a known difference between time scales by which the clock is off ("TAI − UTC", "GPS − UTC", …).
    `own_offset_ns` and `own_jitter_ns` are the delay of the stamps against the sensor's own time in its messages (the
    receiver's GPS time, the radar's own), None without an own time.
    """

    topic: str
    role: Role
    count: int
    rate_hz: float | None
    stamp_source: StampSource
    offset_ns: int | None = None
    drift_ppm: float | None = None
    drift_sigma_ppm: float | None = None
    jitter_ns: int | None = None
    constant: str = ""
    gaps: int = 0
    steps_back: int = 0
    worst_step_back_ns: int = 0
    repeats: int = 0
    own_offset_ns: int | None = None
    own_jitter_ns: int | None = None

    @property
    def stated_jitter_ns(self) -> int | None:
        """The jitter that is shown for the topic: against the sensor's own time if there is one."""
        return self.jitter_ns if self.own_jitter_ns is None else self.own_jitter_ns

    @property
    def stated_against(self) -> str:
        """The reference of `stated_jitter_ns`: `sensor time`, `record time`, or "" without a jitter."""
        if self.own_jitter_ns is not None:
            return "sensor time"
        return "" if self.jitter_ns is None else "record time"

    def as_record(self) -> dict[str, object]:
        """Return the fields and the shown jitter."""
        record = asdict(self)
        record |= {"stated_jitter_ns": self.stated_jitter_ns, "stated_against": self.stated_against}
        for name, digits in (("rate_hz", 3), ("drift_ppm", 2), ("drift_sigma_ppm", 2)):
            record[name] = None if record[name] is None else round(record[name], digits)
        return record


@dataclass(frozen=True)
class ImuLag:
    """The delay of the gyro's stamps against those of `reference` for the same turn; `sigma_ns` its standard error.

    `correlation` (0 to 1) is that of both sensors' turns about the vertical, at this lag.
    """

    topic: str
    reference: str
    lag_ns: int
    sigma_ns: int
    correlation: float

    def as_record(self) -> dict[str, object]:
        return {**asdict(self), "correlation": round(self.correlation, 4)}


@dataclass(frozen=True)
class ClockReport:
    """One `TopicClock` per topic, in the order of the topics; `imu_lag` is None if it could not be recovered."""

    topics: tuple[TopicClock, ...] = ()
    imu_lag: ImuLag | None = None

    def as_record(self) -> dict[str, object]:
        return {
            "topics": [topic.as_record() for topic in self.topics],
            "imu_lag": None if self.imu_lag is None else self.imu_lag.as_record(),
        }
