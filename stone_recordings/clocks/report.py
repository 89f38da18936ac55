"""The clock report: what each topic's stamps say of its clock, and how late the gyro is against the pose source.

**Conventions.** A topic's stamps come from the sensor, from the host that published them, or, where messages carry
none, from the recorder. `offset_ns` is the median of record time − stamp; `drift_ppm` is positive for a stamping clock
that runs fast against the recorder's. None is "cannot be told", never 0. Nothing here shifts a stamp.
"""

from dataclasses import asdict, dataclass
from typing import Literal

from stone_recordings.topics.roles import Role

# Of these nobody reads the stamps.
UNCLOCKED_ROLES: tuple[Role, ...] = ("tf", "tf_static", "camera_info", "other")
StampSource = Literal["sensor", "host", "recorder"]


@dataclass(frozen=True)
class TopicClock:
    """`jitter_ns` is 1.4826 times the median absolute deviation of record time − stamp from its line.

    `constant` names a known difference between time scales that the clock is off by ("TAI − UTC", "GPS − UTC", …).
    `own_offset_ns` and `own_jitter_ns` say how much later the stamps are than the time the sensor itself wrote into
    its messages (the receiver's GPS time, the radar's own), None where it writes none.
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
        """The one jitter that is shown of the topic: against the sensor's own time where it writes one."""
        return self.jitter_ns if self.own_jitter_ns is None else self.own_jitter_ns

    @property
    def stated_against(self) -> str:
        """What `stated_jitter_ns` is against: `sensor time`, `record time`, or nothing where there is none."""
        if self.own_jitter_ns is not None:
            return "sensor time"
        return "" if self.jitter_ns is None else "record time"

    def as_record(self) -> dict[str, object]:
        """The fields and what is stated of the jitter."""
        record = asdict(self)
        record |= {"stated_jitter_ns": self.stated_jitter_ns, "stated_against": self.stated_against}
        for name, digits in (("rate_hz", 3), ("drift_ppm", 2), ("drift_sigma_ppm", 2)):
            record[name] = None if record[name] is None else round(record[name], digits)
        return record


@dataclass(frozen=True)
class ImuLag:
    """How much later the gyro's stamps are than those of `reference` for the same turn; `sigma_ns` its standard error.

    `correlation` (0 to 1) is that of the turn about the vertical as both tell it, at this lag.
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
    """One `TopicClock` per topic, in the order of the topics; `imu_lag` is None where it could not be recovered."""

    topics: tuple[TopicClock, ...] = ()
    imu_lag: ImuLag | None = None

    def as_record(self) -> dict[str, object]:
        return {
            "topics": [topic.as_record() for topic in self.topics],
            "imu_lag": None if self.imu_lag is None else self.imu_lag.as_record(),
        }
