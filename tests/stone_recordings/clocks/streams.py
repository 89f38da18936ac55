"""Small recordings whose clocks are known: topics with chosen stamps and chosen record times."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stone_recordings.report.inspection import Inspection, inspect
from tests.stone_recordings import writing

MS = 1_000_000
IMU, IMAGE, RADAR = "sensor_msgs/msg/Imu", "sensor_msgs/msg/CompressedImage", "ars548_messages/msg/DetectionList"
INSPVAX = "novatel_oem7_msgs/msg/INSPVAX"
GPS_EPOCH_S, LEAP_S, WEEK_MS = 315_964_800, 18, 604_800_000
# A whole millisecond, as GPS time is.
T0_NS = writing.START_NS // MS * MS
Stamps = NDArray[np.int64]


def every(period_ns: int, count: int) -> Stamps:
    return T0_NS + np.arange(count, dtype=np.int64) * period_ns


def stream(topic: str, type_name: str, stamps_ns: Stamps, log_times_ns: Stamps) -> list[writing.Recorded]:
    """Messages with these header stamps; the rest is random."""
    generator = np.random.default_rng(0)
    message = writing.random_message(type_name, generator, is_tame=True)
    recorded = []
    for stamp_ns, log_time_ns in zip(stamps_ns.tolist(), log_times_ns.tolist(), strict=True):
        message.header = writing.header(stamp_ns, "frame")
        recorded.append(writing.Recorded(topic, type_name, log_time_ns, writing.serialised(message)))
    return recorded


def clouds(stamps_ns: Stamps, log_times_ns: Stamps, topic: str = "/lidar") -> list[writing.Recorded]:
    return [
        writing.Recorded(
            topic,
            writing.POINT_CLOUD,
            log_time_ns,
            writing.cloud_payload(
                writing.sweep(writing.HESAI, 1200, 0, stamp_ns), writing.CloudText(stamp_ns=stamp_ns)
            ),
        )
        for stamp_ns, log_time_ns in zip(stamps_ns.tolist(), log_times_ns.tolist(), strict=True)
    ]


def solutions(
    topic: str, times_ns: Stamps, late_ns: Stamps, fields: Sequence[Mapping[str, float]] | None = None
) -> list[writing.Recorded]:
    """INSPVAX valid at `times_ns` (whole milliseconds), stamped and recorded `late_ns` later; `fields` of each."""
    message = writing.random_message(INSPVAX, np.random.default_rng(1), is_tame=True)
    recorded = []
    for row, (time_ns, late) in enumerate(zip(times_ns.tolist(), late_ns.tolist(), strict=True)):
        for name, value in fields[row].items() if fields else ():
            setattr(message, name, value)
        gps_ms = time_ns // MS + (LEAP_S - GPS_EPOCH_S) * 1000
        message.nov_header.gps_week_number, message.nov_header.gps_week_milliseconds = divmod(gps_ms, WEEK_MS)
        message.header = writing.header(time_ns + late, "gps")
        recorded.append(writing.Recorded(topic, INSPVAX, time_ns + late + 100_000, writing.serialised(message)))
    return recorded


def radar_lists(topic: str, stamps_ns: Stamps, own_ns: Stamps, status: int = 1) -> list[writing.Recorded]:
    """ARS 548 lists with header stamps and the radar's own times; recorded 10 ms after the header stamp."""
    message = writing.random_message(RADAR, np.random.default_rng(2), is_tame=True)
    recorded = []
    for stamp_ns, time_ns in zip(stamps_ns.tolist(), own_ns.tolist(), strict=True):
        message.header = writing.header(stamp_ns, "radar")
        message.timestamp_seconds, message.timestamp_nanoseconds = divmod(time_ns, 1_000_000_000)
        message.timestamp_syncstatus = status
        recorded.append(writing.Recorded(topic, RADAR, stamp_ns + 10 * MS, writing.serialised(message)))
    return recorded


def inspected(path: Path, *groups: Sequence[writing.Recorded]) -> Inspection:
    messages = sorted((message for group in groups for message in group), key=lambda message: message.log_time_ns)
    return inspect(writing.write_mcap(path / "run.mcap", messages))


def timing_codes(inspection: Inspection) -> list[tuple[str, str]]:
    """Code and topic of the findings about clocks."""
    return sorted((found.code, found.topic) for found in inspection.findings if found.code.startswith("TIM-"))


def sentence(inspection: Inspection, code: str, topic: str) -> str:
    return next(found.message for found in inspection.findings if (found.code, found.topic) == (code, topic))
