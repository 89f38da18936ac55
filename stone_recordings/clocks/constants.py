"""Known clock errors that are constant differences: leap seconds, time zones.

**Conventions.** A difference is stamp − true time, ns: positive for a clock that is ahead. TAI has been 37 s and GPS
time 18 s ahead of UTC since 2017. Sources: IERS Bulletin C, IS-GPS-200.
"""

NS_PER_S = 1_000_000_000
LIDAR_ENTRY = "kind: lidar, lidar_from_sensor: {translation_m: [0, 0, 0], rotation_wxyz: [1, 0, 0, 0]}"
KNOWN_S = ((37, "TAI-UTC"), (18, "GPS-UTC"), (19, "TAI-GPS"))
# Transport and a slightly wrong clock add up to this to the constant.
TOLERANCE_NS = 400_000_000
SINCE_BOOT = "since boot"
HALF_HOUR_NS = 1_800 * NS_PER_S
LAST_ZONE_HALF_HOURS = 28  # UTC+14
# A clock with a date before 2001 counts from the start of its computer.
FIRST_DATE_NS = 1_000_000_000 * NS_PER_S


def seconds_text(duration_ns: int) -> str:
    """Return "+18.000", to the last nanosecond, in the form of `--time-offset`."""
    seconds, rest_ns = divmod(abs(duration_ns), NS_PER_S)
    millis, nanos = f"{rest_ns:09d}"[:3], f"{rest_ns:09d}"[3:].rstrip("0")
    return f"{'-' if duration_ns < 0 else '+'}{seconds}.{millis}{nanos}"


def shift_advice(part: str, offset_ns: int) -> str:
    """Return how to add an offset to the stamps of a part of the run, "lidar", "pose" or "" for another sensor.

    The calibration entry is that of a LiDAR, or of the sensor whose frame the poses or messages name.
    """
    entry = f"time_offset_ns: {offset_ns}"
    if not part:
        return f"set {entry} of its sensor in the calibration"
    where = f"{{{LIDAR_ENTRY}, {entry}}} among its sensors" if part == "lidar" else f"{entry} of the poses' sensor"
    return (
        f"--time-offset {part}={seconds_text(offset_ns)}s would correct it, and so would the calibration with {where}"
    )


def constant_of(ahead_ns: int, stamp_ns: int = FIRST_DATE_NS) -> str:
    """Return "TAI-UTC", "GPS-UTC", "TAI-GPS", "time zone" or "since boot"; "" for an unknown constant."""
    if abs(ahead_ns) > FIRST_DATE_NS // 2 and abs(stamp_ns) < FIRST_DATE_NS:
        return SINCE_BOOT
    for seconds, name in KNOWN_S:
        if abs(abs(ahead_ns) - seconds * NS_PER_S) < TOLERANCE_NS:
            return name
    half_hours = round(ahead_ns / HALF_HOUR_NS)
    is_zone = 0 < abs(half_hours) <= LAST_ZONE_HALF_HOURS
    return "time zone" if is_zone and abs(ahead_ns - half_hours * HALF_HOUR_NS) < TOLERANCE_NS else ""
