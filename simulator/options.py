"""Options of a simulation: one frozen value, checked at construction.

**Conventions.** Equal options give equal bytes: the seed determines the world, the noise and the jitter, and no code
reads the clock.
"""

from dataclasses import dataclass
from typing import Literal, get_args

from simulator.sensors import rig
from stone.errors import Refused
from stone.splits.surroundings import ILLUMINATIONS

Compression = Literal["none", "lz4", "zstd"]
Traffic = Literal["none", "walker", "busy"]
CameraDetail = Literal["coarse", "half", "full"]
FaultName = Literal[
    "gnss_jitter",
    "clock_18s",
    "clock_37s",
    "camera_late_5ms",
    "camera_dropped",
    "radar_drift_50ppm",
    "imu_lag_12ms",
    "rtk_gap",
    "position_jump",
    "stamps_back",
    "cameras_swapped",
    "extrinsic_inverted",
]
FAULT_NAMES: tuple[FaultName, ...] = get_args(FaultName)
LIDAR_HZ = (1, 2, 5, 10, 20)
USUAL_SWEEP_NS = 100_000_000
MAX_CHANNELS = 512
MAX_COLUMNS = 7200
MAX_SECONDS = 3600.0
MIN_CAMERA_WIDTH_PX, MAX_CAMERA_WIDTH_PX = 32, 4096
MAX_TRANSPORT_JITTER_NS = 4_000_000  # less than the IMU's period, so that messages of a topic keep their order


@dataclass(frozen=True)
class SimulateOptions:
    """The options: `channels` × `columns` rays per sweep; the world is as long as the drive and `world_width_m` wide.

    `lidar_hz` is in sweeps per second: below 10 Hz each sweep takes 0.1 s, as if a recorder dropped some; at 20 Hz 0.05
    s. `speed_m_s` is the robot's average speed, which varies by 15 %. `traffic` selects the movers besides the robot
    (`simulator/scenery/movers.py`); `busy`: three walkers and two vehicles.

    The default compression lz4 nearly halves the bag at no measurable time, because packet stamps, rings and missing
    returns repeat. The compression zstd is smaller, but costs more to write and twice as much to read.

    `camera_detail` is `coarse`, 80 × 50 rays per image, enlarged; `half`, a ray for every 2 × 2 pixels and a sensor's
    noise; or `full`, a ray for each pixel. Full images suit training, at a cost (docs/research/benchmarks.md).
    `illumination` is a word of the platform.

    `noise_ratio` scales the sensors' noise: 0 measures exactly, 1 is the paper's rig. `range_noise` adds the other
    disturbances of real LiDAR ranges (`simulator/sensors/lidar.py`). `beside_track` adds rocks and bushes close to the
    robot's path, and tall grass on it. The receiver's driver stamps up to `host_delay_max_ns` late (0: at the time of
    validity, as on a disciplined host). Messages reach the recorder up to `transport_jitter_ns` late. `faults` apply in
    the given order.
    """

    seconds: float = 20.0
    seed: int = 1
    channels: int = 64
    columns: int = 900
    cameras: bool = True
    camera_width_px: int = 480
    camera_detail: CameraDetail = "coarse"
    illumination: str = "day"
    compression: Compression = "lz4"
    world_width_m: float = 110.0
    noise_ratio: float = 1.0
    range_noise: bool = False
    beside_track: bool = False
    traffic: Traffic = "walker"
    lidar_hz: int = 10
    speed_m_s: float = 1.5
    host_delay_max_ns: int = 20_000_000
    transport_jitter_ns: int = 0
    faults: tuple[FaultName, ...] = ()

    def __post_init__(self) -> None:
        _within("seconds", self.seconds, 0.2, MAX_SECONDS)
        _within("seed", self.seed, 0, 2**31)
        _within("channels", self.channels, 2, MAX_CHANNELS)
        _within("columns", self.columns, 12, MAX_COLUMNS)
        _within("camera_width_px", self.camera_width_px, MIN_CAMERA_WIDTH_PX, MAX_CAMERA_WIDTH_PX)
        _within("world_width_m", self.world_width_m, 30.0, 400.0)
        _within("speed_m_s", self.speed_m_s, 0.1, 10.0)
        if self.lidar_hz not in LIDAR_HZ:
            raise Refused(
                "bad_simulation_option",
                f"lidar_hz is {self.lidar_hz!r}; it must be one of {', '.join(map(str, LIDAR_HZ))}",
            )
        if self.compression not in ("none", "lz4", "zstd"):
            raise Refused("bad_simulation_option", f"compression is {self.compression!r}; it must be none, lz4 or zstd")
        _within("noise_ratio", self.noise_ratio, 0.0, 10.0)
        _within("host_delay_max_ns", self.host_delay_max_ns, 0, 45_000_000)
        _within("transport_jitter_ns", self.transport_jitter_ns, 0, MAX_TRANSPORT_JITTER_NS)
        if self.traffic not in get_args(Traffic):
            raise Refused(
                "bad_simulation_option",
                f"traffic is {self.traffic!r}; it must be one of {', '.join(get_args(Traffic))}",
            )
        if self.camera_detail not in get_args(CameraDetail):
            raise Refused(
                "bad_simulation_option",
                f"camera_detail is {self.camera_detail!r}; it must be one of {', '.join(get_args(CameraDetail))}",
            )
        if self.illumination not in ILLUMINATIONS:
            raise Refused(
                "bad_simulation_option",
                f"illumination is {self.illumination!r}; it must be one of {', '.join(ILLUMINATIONS)}",
            )
        for fault in self.faults:
            if fault not in FAULT_NAMES:
                raise Refused(
                    "bad_simulation_option", f"faults is {fault!r}; it must be one of {', '.join(FAULT_NAMES)}"
                )

    @property
    def sweep_ns(self) -> int:
        """The duration of one sweep."""
        return min(USUAL_SWEEP_NS, self.sweep_period_ns)

    @property
    def sweep_period_ns(self) -> int:
        """The time between the stamps of two sweeps."""
        return 1_000_000_000 // self.lidar_hz


def _within(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise Refused("bad_simulation_option", f"{name} is {value!r}; it must be from {low:g} to {high:g}")


# The topics of the simulated rig and their types. Names are those of the drivers of the paper's sensors; the rig names
# its cameras and radars.


LIDAR_TOPIC = "/lidar_points"
INSPVAX_TOPIC, BESTPOS_TOPIC = "/novatel/oem7/inspvax", "/novatel/oem7/bestpos"
IMU_TOPIC, TF_STATIC_TOPIC = "/imu/data", "/tf_static"


def topics(options: SimulateOptions) -> dict[str, str]:
    """Return every topic of the bag and its type."""
    kinds = {LIDAR_TOPIC: "sensor_msgs/msg/PointCloud2", IMU_TOPIC: "sensor_msgs/msg/Imu"}
    kinds |= {TF_STATIC_TOPIC: "tf2_msgs/msg/TFMessage"}
    kinds |= {INSPVAX_TOPIC: "novatel_oem7_msgs/msg/INSPVAX", BESTPOS_TOPIC: "novatel_oem7_msgs/msg/BESTPOS"}
    kinds |= {rig.radar_topic(channel): "ars548_messages/msg/DetectionList" for channel in rig.RADARS}
    if options.cameras:
        kinds |= {camera.topic: "sensor_msgs/msg/CompressedImage" for camera in rig.cameras()}
        kinds |= {rig.camera_info_topic(camera): "sensor_msgs/msg/CameraInfo" for camera in rig.cameras()}
    return kinds
