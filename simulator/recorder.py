"""Conversion of sensor measurements into messages with the stamps and record times of their drivers.

**Conventions.** Record times lag the measurement: a sweep is published when it is complete, an image after exposure and
transfer, the receiver's logs at their (host) header stamp. No message is recorded before its own window begins.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from simulator import ros_messages
from simulator.bag_writer import BagWriter
from simulator.cdr_writer import CdrLayout, stamp_parts
from simulator.faults import Fault
from simulator.options import (
    BESTPOS_TOPIC,
    IMU_TOPIC,
    INSPVAX_TOPIC,
    LIDAR_TOPIC,
    TF_STATIC_TOPIC,
    SimulateOptions,
    topics,
)
from simulator.ros_messages import POINT_STEP_BYTES
from simulator.scenery.world import generator
from simulator.sensors import rig
from simulator.sensors.cameras import SimulatedPicture
from simulator.sensors.navigation import ACCELERATION_NOISE_M_S2, GYRO_NOISE_RAD_S, UNDULATION_M, Fixes, Inertia
from simulator.sensors.radar import RadarLists
from stone.geometry.se3 import SE3

BASE_FRAME, LIDAR_FRAME, INS_FRAME, IMU_FRAME = "base_link", "hesai_lidar", "gps", "imu_link"
LIDAR_DELAY_NS = rig.SWEEP_NS + 8_000_000
CAMERA_DELAY_NS = 22_000_000
RADAR_DELAY_NS = 12_000_000
PUBLISH_DELAY_NS = 200_000
SOLUTION_GOOD, FINE_STEERING = 3, 180
INS_RTK_FIXED, INS_RTK_FLOAT, NARROW_INT, NARROW_FLOAT = 56, 55, 50, 34


class Recorder:
    """The rig's topics in one bag; `fault` changes the sensors' clocks."""

    def __init__(self, bag: BagWriter, options: SimulateOptions, fault: Fault) -> None:
        self._bag = bag
        self._options = options
        self._fault = fault
        self._transport = generator(options.seed, "transport")
        self._cloud = ros_messages.cloud_head(LIDAR_FRAME)
        self._inspvax, self._bestpos = ros_messages.inspvax(INS_FRAME), ros_messages.bestpos(INS_FRAME)
        self._imu = ros_messages.imu(IMU_FRAME)
        self._lists = [ros_messages.detection_list(rig.radar_frame_id(channel)) for channel in rig.RADARS]
        self._images = {c.topic: ros_messages.compressed_image_head(c.frame_id) for c in rig.cameras()}
        self._infos = {c.topic: _info_layout(c, options) for c in rig.cameras()}
        for topic, kind in topics(options).items():
            bag.declare(topic, kind)

    def static_transforms(self, stamp_ns: int) -> None:
        """Record every mount under `base_link`, once."""
        frames = {LIDAR_FRAME: rig.EGO_FROM_LIDAR}
        for mount in rig.calibration(self._options.camera_width_px).mounts:
            frames[mount.frame_id] = rig.EGO_FROM_LIDAR @ mount.lidar_from_sensor
        layout = ros_messages.static_transforms([(BASE_FRAME, frame) for frame in frames])
        record = layout.records(1)
        for index, base_from_frame in enumerate(frames.values()):
            _put_transform(record, index, base_from_frame, stamp_ns)
        self._add(TF_STATIC_TOPIC, stamp_ns, record.tobytes())

    def sweep(self, stamp_ns: int, points: NDArray[np.void]) -> None:
        shown_ns = self._shown_ns(LIDAR_TOPIC, stamp_ns)
        if shown_ns != stamp_ns:
            points["timestamp"] += (shown_ns - stamp_ns) / 1e9
        record = _stamped(self._cloud, shown_ns)
        record["width"] = len(points)
        record["row_step"] = record["data_length"] = len(points) * POINT_STEP_BYTES
        self._add(LIDAR_TOPIC, stamp_ns + LIDAR_DELAY_NS, record.tobytes() + points.tobytes() + b"\0")

    def picture(self, picture: SimulatedPicture) -> None:
        log_time_ns, topic = picture.stamp_ns + CAMERA_DELAY_NS, picture.camera.topic
        shown_ns = self._shown_ns(topic, picture.stamp_ns)
        record = _stamped(self._images[topic], shown_ns)
        record["data_length"] = len(picture.jpeg)
        self._add(topic, log_time_ns, record.tobytes() + picture.jpeg)
        info = _stamped(self._infos[topic], shown_ns)
        self._add(rig.camera_info_topic(picture.camera), log_time_ns, info.tobytes())

    def radar_lists(self, lists: RadarLists) -> None:
        for index, channel in enumerate(rig.RADARS):
            shown_ns = self._shown_ns(rig.radar_topic(channel), lists.stamp_ns)
            record = _stamped(self._lists[index], shown_ns)
            record["timestamp_seconds"], record["timestamp_nanoseconds"] = divmod(shown_ns, 1_000_000_000)
            record["list_detections"] = lists.detections[index]
            record["list_numofdetections"] = lists.counts[index]
            self._add(rig.radar_topic(channel), lists.stamp_ns + RADAR_DELAY_NS, record.tobytes())

    def inertia(self, inertia: Inertia, window: slice) -> None:
        stamps = inertia.stamps_ns[window]
        records = _stamped_all(self._imu, self._fault.clock(IMU_TOPIC, stamps))
        records["angular_velocity"] = inertia.angular_velocity_rad_s[window]
        records["linear_acceleration"] = inertia.linear_acceleration_m_s2[window]
        records["angular_velocity_covariance"] = np.eye(3).ravel() * GYRO_NOISE_RAD_S**2
        records["linear_acceleration_covariance"] = np.eye(3).ravel() * ACCELERATION_NOISE_M_S2**2
        self._add_all(IMU_TOPIC, stamps + PUBLISH_DELAY_NS, records)

    def fixes(self, fixes: Fixes, window: slice) -> None:
        host = fixes.host_stamps_ns[window]
        for topic, layout, fill in (
            (INSPVAX_TOPIC, self._inspvax, _fill_inspvax),
            (BESTPOS_TOPIC, self._bestpos, _fill_bestpos),
        ):
            records = _stamped_all(layout, self._fault.clock(topic, host))
            _fill_receiver(records, fixes, window, fill)
            self._add_all(topic, host + PUBLISH_DELAY_NS, records)

    def _add_all(self, topic: str, log_times_ns: NDArray[np.int64], records: NDArray[np.void]) -> None:
        for log_time_ns, record in zip(log_times_ns.tolist(), records, strict=True):
            self._add(topic, log_time_ns, record.tobytes())

    def _add(self, topic: str, log_time_ns: int, payload: bytes) -> None:
        jitter_ns = self._options.transport_jitter_ns
        late_ns = int(self._transport.integers(0, jitter_ns)) if jitter_ns else 0
        self._bag.add(topic, log_time_ns + late_ns, payload)

    def _shown_ns(self, topic: str, stamp_ns: int) -> int:
        """Return the reading of the sensor's clock at a true time."""
        return int(self._fault.clock(topic, np.array([stamp_ns], np.int64))[0])


def _stamped(layout: CdrLayout, stamp_ns: int) -> NDArray[np.void]:
    return _stamped_all(layout, np.array([stamp_ns], np.int64))


def _stamped_all(layout: CdrLayout, stamps_ns: NDArray[np.int64]) -> NDArray[np.void]:
    records = layout.records(len(stamps_ns))
    records["sec"], records["nanosec"] = stamp_parts(stamps_ns)
    return records


def _put_transform(record: NDArray[np.void], index: int, parent_from_child: SE3, stamp_ns: int) -> None:
    record[f"sec_{index}"], record[f"nanosec_{index}"] = divmod(stamp_ns, 1_000_000_000)
    record[f"translation_{index}"] = parent_from_child.translation_m
    record[f"rotation_xyzw_{index}"] = parent_from_child.wxyz[[1, 2, 3, 0]]


def _info_layout(camera: rig.CameraSpec, options: SimulateOptions) -> CdrLayout:
    lens = rig.intrinsics(options.camera_width_px)
    layout = ros_messages.camera_info(camera.frame_id, lens.model, len(lens.distortion))
    k = np.array([[lens.fx_px, 0, lens.cx_px], [0, lens.fy_px, lens.cy_px], [0, 0, 1]])
    template = layout.records(1)
    template["width"], template["height"] = lens.width_px, lens.height_px
    template["k"], template["r"] = k.ravel(), np.eye(3).ravel()
    template["p"] = np.concatenate([k, np.zeros((3, 1))], axis=1).ravel()
    return CdrLayout(layout.dtype, template.tobytes())


def _fill_receiver(
    records: NDArray[np.void], fixes: Fixes, window: slice, fill: Callable[[NDArray[np.void], Fixes, slice], None]
) -> None:
    week, ms = (values[window] for values in fixes.gps_week_ms())
    records["gps_week_number"], records["gps_week_milliseconds"] = week, ms
    records["time_status"] = FINE_STEERING
    fill(records, fixes, window)


def _fill_inspvax(records: NDArray[np.void], fixes: Fixes, window: slice) -> None:
    records["ins_status"] = SOLUTION_GOOD
    records["pos_type"] = np.where(fixes.is_rtk_fixed[window], INS_RTK_FIXED, INS_RTK_FLOAT)
    for axis, name in enumerate(("latitude", "longitude", "height")):
        records[name] = fixes.geodetic_deg_m[window, axis]
        records[f"{name}_stdev"] = fixes.position_stdev_m[window]
    for axis, name in enumerate(("east_velocity", "north_velocity", "up_velocity")):
        records[name] = fixes.velocity_enu_m_s[window, axis]
        records[f"{name}_stdev"] = 0.02
    for axis, name in enumerate(("roll", "pitch", "azimuth")):
        records[name] = fixes.roll_pitch_azimuth_deg[window, axis]
        records[f"{name}_stdev"] = 0.03
    records["undulation"] = UNDULATION_M


def _fill_bestpos(records: NDArray[np.void], fixes: Fixes, window: slice) -> None:
    records["pos_type"] = np.where(fixes.is_rtk_fixed[window], NARROW_INT, NARROW_FLOAT)
    records["lat"], records["lon"] = fixes.geodetic_deg_m[window, 0], fixes.geodetic_deg_m[window, 1]
    records["hgt"] = fixes.geodetic_deg_m[window, 2] - UNDULATION_M
    records["undulation"] = UNDULATION_M
    for name in ("lat_stdev", "lon_stdev", "hgt_stdev"):
        records[name] = fixes.position_stdev_m[window]
    records["num_svs"] = records["num_sol_svs"] = 24
