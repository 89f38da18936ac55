"""Facts about a recording, by kind of sensor: plain numbers for the record, the score and the page.

**Conventions.** `at_ns` is log time since the recording's start, ascending; a value's tuples of the same length are
samples at those instants. Ratios are 0 to 1. A median over no samples is None, never 0.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from statistics import median
from typing import Literal

SIGNIFICANT = 4
RtkWord = Literal["fixed", "float", "other"]


@dataclass(frozen=True)
class Coverage:
    """The deliveries of a periodic topic: `covered` (per bin) and `rates_hz` divide the recording evenly.

    `covered_ratio` is the share of the recording in which the next message came in time. Topics without a period, such
    as latched ones, have None, and empty `covered` and `rates_hz`. `gaps_ns` are the longest gaps between stamps, as
    (start, end), shifted to log time by the topic's median delay.
    """

    topic: str
    role: str
    count: int
    rate_hz: float | None
    first_ns: int
    last_ns: int
    covered_ratio: float | None
    covered: tuple[float, ...]
    rates_hz: tuple[float, ...]
    gaps_ns: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True)
class CameraFacts:
    """`sharpness` is the variance of the Laplacian of 8-bit luminance in pictures at most 640 px wide (Pech-Pacheco et
    al., ICPR 2000).

    `dark_ratio` and `bright_ratio` are the shares of pixels at either end of the range.
    """

    topic: str
    channel: str
    size_px: tuple[int, int]
    at_ns: tuple[int, ...]
    sharpness: tuple[float, ...]
    brightness_ratio: tuple[float, ...]
    dark_ratio: tuple[float, ...]
    bright_ratio: tuple[float, ...]


@dataclass(frozen=True)
class LidarFacts:
    """The slots for points in a cloud, the share of them that returned, and the median range of returns."""

    topic: str
    at_ns: tuple[int, ...]
    slots: tuple[int, ...]
    valid_ratio: tuple[float, ...]
    range_m: tuple[float, ...]


@dataclass(frozen=True)
class RadarFacts:
    """Detections per message."""

    topic: str
    at_ns: tuple[int, ...]
    detections: tuple[int, ...]


@dataclass(frozen=True)
class RtkFacts:
    """The receiver's own report of its solution, per sample; `stdev_m` is horizontal (the larger axis)."""

    topic: str
    at_ns: tuple[int, ...]
    words: tuple[RtkWord, ...]
    stdev_m: tuple[float, ...]

    def share(self, word: RtkWord) -> float:
        """Return the share of samples with this word, 0 to 1; 0 without samples."""
        return self.words.count(word) / max(1, len(self.words))


@dataclass(frozen=True)
class Facts:
    """All measured facts; empty tuples and None if the recording has no such sensor. `start_ns` is log time."""

    start_ns: int = 0
    coverage: tuple[Coverage, ...] = ()
    cameras: tuple[CameraFacts, ...] = ()
    lidars: tuple[LidarFacts, ...] = ()
    radars: tuple[RadarFacts, ...] = ()
    rtk: RtkFacts | None = None

    def as_record(self) -> dict[str, object]:
        rtk = None if self.rtk is None else {**_record(self.rtk), "fixed_ratio": _rounded(self.rtk.share("fixed"))}
        return {
            "start_ns": self.start_ns,
            "coverage": [_record(topic) for topic in self.coverage],
            "cameras": [_record(camera) for camera in self.cameras],
            "lidars": [_record(lidar) for lidar in self.lidars],
            "radars": [_record(radar) for radar in self.radars],
            "rtk": rtk,
        }


def middle(values: Sequence[float]) -> float | None:
    """Return the median; None without values."""
    return median(values) if values else None


def _record(fact: Coverage | CameraFacts | LidarFacts | RadarFacts | RtkFacts) -> dict[str, object]:
    return {name: _rounded(value) for name, value in asdict(fact).items()}


def _rounded(value: object) -> object:
    if isinstance(value, float):
        return float(f"{value:.{SIGNIFICANT}g}")
    return [_rounded(part) for part in value] if isinstance(value, tuple) else value
