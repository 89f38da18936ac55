"""Names of frames on robots: the kind of sensor each means, which two mean one sensor, its channel.

**Conventions.** A name is split at everything that is no letter, and digits are dropped from its words for the kind
(`cam0` is a camera). Names decide nothing that a file says otherwise, and nothing at all between two that fit.
"""

import re

from stone.sensors.calibration import SensorKind

# In the order in which they are asked: `os_imu` is an IMU, `lidar_camera` a camera.
KINDS: tuple[tuple[SensorKind, frozenset[str]], ...] = (
    ("imu", frozenset({"imu", "xsens", "microstrain"})),
    ("camera", frozenset({"camera", "cam"})),
    ("radar", frozenset({"radar", "ars", "srr"})),
    ("ins", frozenset({"ins", "gnss", "gps", "novatel", "inspvax"})),
    ("lidar", frozenset({"lidar", "laser", "velodyne", "hesai", "pandar", "ouster", "os", "vlp", "livox", "rslidar"})),
)
MEANINGLESS = frozenset({"link", "frame", "optical", "base", "sensor", "mount"})
# Where a robot stands on the ground comes first: the ego frame's origin is there (REP 105 and 120).
EGO_FRAMES = ("base_footprint", "ground_projection", "ego", "ego_vehicle", "base_link", "base", "car_center")
DIRECTIONS = {
    "front": "FRONT", "forward": "FRONT", "back": "BACK", "rear": "BACK", "left": "LEFT", "right": "RIGHT",
}  # fmt: skip
# What may stand beside a direction: front_center_camera is the front one, traffic_light_right_camera no right one.
SAYING_NOTHING = frozenset({"camera", "cam", "radar", "center", "centre", "middle", "rgb", "color"})
PREFIXES = {"camera": "CAM", "radar": "RADAR"}


def words_of(name: str) -> list[str]:
    return [word for word in re.split(r"[^a-z0-9]+", name.lower()) if word]


def kind_of(name: str) -> SensorKind | None:
    """What a frame or sensor is by its name; None for what names no sensor (base_link, sensor_kit_base_link)."""
    bare = {re.sub(r"\d+", "", word) for word in words_of(name)}
    if "kit" in bare:
        return None
    return next((kind for kind, meaning in KINDS if bare & meaning), None)


def sensor_key(name: str) -> str:
    """Equal for the frames of one sensor: camera_front_link, camera_front_optical_frame; os_sensor, os_lidar."""
    kinds = frozenset[str]().union(*(meaning for _, meaning in KINDS)) - {"os"}
    words = [word for word in words_of(name) if word not in MEANINGLESS]
    return "_".join(word for word in words if word not in kinds) or "_".join(words)


def is_optical(name: str) -> bool:
    return "optical" in words_of(name)


def channel_of(name: str, kind: SensorKind) -> str:
    """CAM_FRONT_LEFT for camera_front_left, INS and IMU for theirs; else the name itself."""
    if kind in ("ins", "imu"):
        return kind.upper()
    words = words_of(name)
    others = set(words) - MEANINGLESS - SAYING_NOTHING - set(DIRECTIONS)
    found = {DIRECTIONS[word] for word in words if word in DIRECTIONS}
    places = [place for place in ("FRONT", "BACK", "LEFT", "RIGHT") if place in found]
    return "_".join([PREFIXES[kind], *places]) if kind in PREFIXES and places and not others else name
