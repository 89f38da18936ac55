"""The messages of the rig as layouts, byte for byte as the drivers of the paper's sensors publish them.

**Conventions.** Field names as in the ROS definitions; nested names are joined by their last word if it is unambiguous.
Sources: sensor_msgs and tf2_msgs (Humble), HesaiLidar_ROS_2.0 (26-byte points), ars548_messages, novatel_oem7_msgs
(Humble branch).
"""

import numpy as np

from simulator.cdr_writer import CdrLayout, CdrMember, CdrText, header, layout, sequence_length

POINT_STEP_BYTES = 26
POINT_OFFSETS_BYTES = {"x": 0, "y": 4, "z": 8, "intensity": 12, "ring": 16, "timestamp": 18}
HESAI_POINT = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "ring", "timestamp"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<u2", "<f8"],
        "offsets": list(POINT_OFFSETS_BYTES.values()),
        "itemsize": POINT_STEP_BYTES,
    }
)
POINT_FIELD_TYPES = {"x": 7, "y": 7, "z": 7, "intensity": 7, "ring": 4, "timestamp": 8}

MAX_DETECTIONS = 800
DETECTION_STRIDE_BYTES = 52
DETECTION = np.dtype(
    {
        "names": [
            "azimuth", "azimuth_std", "invalid_flags", "elevation", "elevation_std", "range", "range_std",
            "range_rate", "range_rate_std", "rcs", "measurement_id", "positive_predictive_value", "classification",
            "multi_target_probability", "object_id", "ambiguity_flag", "sort_index",
        ],
        "formats": [
            "<f4", "<f4", "u1", "<f4", "<f4", "<f4", "<f4", "<f4", "<f4",
            "i1", "<u2", "u1", "u1", "u1", "<u2", "u1", "<u2",
        ],
        "offsets": [0, 4, 8, 12, 16, 20, 24, 28, 32, 36, 38, 40, 41, 42, 44, 46, 48],
        "itemsize": DETECTION_STRIDE_BYTES,
    }
)  # fmt: skip


def cloud_head(frame_id: str) -> CdrLayout:
    """Return sensor_msgs/PointCloud2 up to the points; `is_dense` (one byte) follows them."""
    members: list[CdrMember | CdrText] = [*header(frame_id), CdrMember("height", "<u4", 1), CdrMember("width", "<u4")]
    members.append(sequence_length("field_count", len(POINT_FIELD_TYPES)))
    for name, code in POINT_FIELD_TYPES.items():
        members += [
            CdrText(f"{name}_name", name),
            CdrMember(f"{name}_offset", "<u4", POINT_OFFSETS_BYTES[name]),
            CdrMember(f"{name}_datatype", "u1", code),
            CdrMember(f"{name}_count", "<u4", 1),
        ]
    members += [
        CdrMember("is_bigendian", "u1"),
        CdrMember("point_step", "<u4", POINT_STEP_BYTES),
        CdrMember("row_step", "<u4"),
    ]
    return layout([*members, sequence_length("data_length")])


def compressed_image_head(frame_id: str) -> CdrLayout:
    """Return sensor_msgs/CompressedImage up to the JPEG bytes."""
    return layout([*header(frame_id), CdrText("format", "jpeg"), sequence_length("data_length")])


def camera_info(frame_id: str, model: str, coefficients: int) -> CdrLayout:
    """Return sensor_msgs/CameraInfo."""
    roi = [CdrMember(f"roi_{name}", "<u4") for name in ("x_offset", "y_offset", "height", "width")]
    return layout(
        [
            *header(frame_id), CdrMember("height", "<u4"), CdrMember("width", "<u4"), CdrText("distortion_model",
            model),
            sequence_length("d_length", coefficients), CdrMember("d", f"({coefficients},)<f8"),
            CdrMember("k", "(9,)<f8"),
            CdrMember("r", "(9,)<f8"), CdrMember("p", "(12,)<f8"), CdrMember("binning_x", "<u4"),
            CdrMember("binning_y", "<u4"),
            *roi, CdrMember("do_rectify", "u1"),
        ]
    )  # fmt: skip


def imu(frame_id: str) -> CdrLayout:
    """Return sensor_msgs/Imu without an orientation (first covariance −1), like the Epson driver."""
    absent = np.array([-1.0, 0, 0, 0, 0, 0, 0, 0, 0])
    return layout(
        [
            *header(frame_id),
            CdrMember("orientation_xyzw", "(4,)<f8", np.array([0.0, 0, 0, 1])),
            CdrMember("orientation_covariance", "(9,)<f8", absent),
            CdrMember("angular_velocity", "(3,)<f8"),
            CdrMember("angular_velocity_covariance", "(9,)<f8"),
            CdrMember("linear_acceleration", "(3,)<f8"),
            CdrMember("linear_acceleration_covariance", "(9,)<f8"),
        ]
    )


def _oem7_header(name: str, message_id: int) -> list[CdrMember | CdrText]:
    return [
        CdrText("message_name", name), CdrMember("message_id", "<u2", message_id), CdrMember("message_type", "u1"),
        CdrMember("sequence_number", "<u4"), CdrMember("time_status", "u1"), CdrMember("gps_week_number", "<u2"),
        CdrMember("gps_week_milliseconds", "<u4"), CdrMember("receiver_status", "<u4"),
        CdrMember("idle_time", "<f4", 40.0),
    ]  # fmt: skip


def inspvax(frame_id: str) -> CdrLayout:
    """Return novatel_oem7_msgs/INSPVAX (log 1465)."""
    doubles = ("latitude", "longitude", "height")
    motion = ("north_velocity", "east_velocity", "up_velocity", "roll", "pitch", "azimuth")
    deviations = ("latitude", "longitude", "height", *motion)
    return layout(
        [
            *header(frame_id), *_oem7_header("INSPVAX", 1465),
            CdrMember("ins_status", "<u4"), CdrMember("pos_type", "<u4"), *(CdrMember(name, "<f8") for name in doubles),
            CdrMember("undulation", "<f4"), *(CdrMember(name, "<f8") for name in motion),
            *(CdrMember(f"{name}_stdev", "<f4") for name in deviations),
            CdrMember("ext_sol_status", "<u4"), CdrMember("time_since_update", "<u2"),
        ]
    )  # fmt: skip


def bestpos(frame_id: str) -> CdrLayout:
    """Return novatel_oem7_msgs/BESTPOS (log 42); `hgt` is above mean sea level."""
    counts = ("num_svs", "num_sol_svs", "num_sol_l1_svs", "num_sol_multi_svs", "reserved", "ext_sol_stat")
    return layout(
        [
            *header(frame_id), *_oem7_header("BESTPOS", 42),
            CdrMember("sol_status", "<u4"), CdrMember("pos_type", "<u4"), CdrMember("lat", "<f8"),
            CdrMember("lon", "<f8"),
            CdrMember("hgt", "<f8"), CdrMember("undulation", "<f4"), CdrMember("datum_id", "<u4", 61),
            CdrMember("lat_stdev", "<f4"), CdrMember("lon_stdev", "<f4"), CdrMember("hgt_stdev", "<f4"),
            CdrMember("stn_id", "(4,)i1"), CdrMember("diff_age", "<f4"), CdrMember("sol_age", "<f4"),
            *(CdrMember(name, "u1") for name in counts),
            CdrMember("galileo_beidou_sig_mask", "u1"), CdrMember("gps_glonass_sig_mask", "u1"),
        ]
    )  # fmt: skip


def detection_list(frame_id: str) -> CdrLayout:
    """Return ars548_messages/DetectionList: always 800 slots, `list_numofdetections` of them valid."""
    pose = ("xpos", "xstd", "ypos", "ystd", "zpos", "zstd", "roll", "rollstd", "pitch", "pitchstd", "yaw", "yawstd")
    return layout(
        [
            *header(frame_id), CdrMember("crc", "<u8"), CdrMember("length", "<u4"), CdrMember("sqc", "<u4"),
            CdrMember("dataid", "<u4"), CdrMember("timestamp_nanoseconds", "<u4"),
            CdrMember("timestamp_seconds", "<u4"),
            CdrMember("timestamp_syncstatus", "u1", 1), CdrMember("eventdataqualifier", "<u4"),
            CdrMember("extendedqualifier", "u1"), CdrMember("origin_invalidflags", "<u2"),
            *(CdrMember(f"origin_{name}", "<f4") for name in pose), CdrMember("list_invalidflags", "u1"),
            CdrMember("list_detections", (DETECTION, (MAX_DETECTIONS,))),
            CdrMember("list_radveldomain_min", "<f4", -60.0), CdrMember("list_radveldomain_max", "<f4", 30.0),
            CdrMember("list_numofdetections", "<u4"), CdrMember("aln_azimuthcorrection", "<f4"),
            CdrMember("aln_elevationcorrection", "<f4"), CdrMember("aln_status", "u1"),
        ]
    )  # fmt: skip


def static_transforms(frame_pairs: list[tuple[str, str]]) -> CdrLayout:
    """Return tf2_msgs/TFMessage; pair i has the fields `translation_i` and `rotation_xyzw_i`, parent_from_child."""
    members: list[CdrMember | CdrText] = [sequence_length("transform_count", len(frame_pairs))]
    for index, (parent, child) in enumerate(frame_pairs):
        members += [
            CdrMember(f"sec_{index}", "<i4"),
            CdrMember(f"nanosec_{index}", "<u4"),
            CdrText(f"parent_{index}", parent),
            CdrText(f"child_{index}", child),
            CdrMember(f"translation_{index}", "(3,)<f8"),
            CdrMember(f"rotation_xyzw_{index}", "(4,)<f8"),
        ]
    return layout(members)
