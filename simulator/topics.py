"""The topics of the simulated rig and what each one carries.

**Conventions.** Names are those of the drivers of the paper's sensors; the rig names its cameras and radars.
"""

from simulator.options import SimulateOptions
from simulator.sensors import rig

LIDAR_TOPIC = "/lidar_points"
INSPVAX_TOPIC, BESTPOS_TOPIC = "/novatel/oem7/inspvax", "/novatel/oem7/bestpos"
IMU_TOPIC, TF_STATIC_TOPIC = "/imu/data", "/tf_static"


def topics(options: SimulateOptions) -> dict[str, str]:
    """Every topic of the bag and its type."""
    kinds = {LIDAR_TOPIC: "sensor_msgs/msg/PointCloud2", IMU_TOPIC: "sensor_msgs/msg/Imu"}
    kinds |= {TF_STATIC_TOPIC: "tf2_msgs/msg/TFMessage"}
    kinds |= {INSPVAX_TOPIC: "novatel_oem7_msgs/msg/INSPVAX", BESTPOS_TOPIC: "novatel_oem7_msgs/msg/BESTPOS"}
    kinds |= {rig.radar_topic(channel): "ars548_messages/msg/DetectionList" for channel in rig.RADARS}
    if options.cameras:
        kinds |= {camera.topic: "sensor_msgs/msg/CompressedImage" for camera in rig.cameras()}
        kinds |= {rig.camera_info_topic(camera): "sensor_msgs/msg/CameraInfo" for camera in rig.cameras()}
    return kinds
