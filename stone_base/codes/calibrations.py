"""Meanings of CAL codes: intrinsics, extrinsics, and the files that hold them."""

from stone_base.codes.meaning import CodeMeaning

MEANINGS = (
    CodeMeaning(
        "CAL-401",
        "wrong",
        "A rotation matrix is rounded, so the nearest rotation is used. A matrix too far from any rotation is refused.",
        "Enter the matrix with more digits.",
        as_error="refused",
    ),
    CodeMeaning(
        "CAL-402",
        "wrong",
        "A quaternion does not have unit length, or seems to have the order x, y, z, w. A quaternion too far "
        "from unit length is refused.",
        "Enter w first, and use more digits.",
        as_error="refused",
    ),
    CodeMeaning(
        "CAL-403",
        "wrong",
        "The calibrated image size of a camera differs from the recorded size, so points are projected to the "
        "wrong pixels.",
        "Enter the intrinsics for the recorded image size.",
    ),
    CodeMeaning(
        "CAL-404",
        "wrong",
        "A camera does not look in the direction of its name, or a transform is inverted.",
        "Invert the transform, or check the mount.",
    ),
    CodeMeaning(
        "CAL-405",
        "wrong",
        "The calibration does not place the frame of the poses, so the ego frame is assumed. A calibration "
        "with this sensor but without a chain of transforms to the LiDAR is refused.",
        "Add the sensor with that frame_id to the calibration, or use --poses-frame.",
        as_error="refused",
    ),
    CodeMeaning(
        "CAL-406",
        "wrong",
        "A camera fires when the LiDAR scans the direction of another camera: the two cameras are swapped.",
        "Check the topics and plugs of the two cameras.",
    ),
    CodeMeaning(
        "CAL-407",
        "refused",
        "The last row of a matrix is not 0 0 0 1.",
        "Check rows and columns: the matrix may be transposed.",
    ),
    CodeMeaning(
        "CAL-408", "refused", "A transform contains a reflection.", "Check the signs and the order of the axes."
    ),
    CodeMeaning(
        "CAL-409",
        "wrong",
        "A sensor is more than 10 m from the LiDAR. Distances beyond 100 m are refused.",
        "Check the unit: it must be metres.",
        as_error="refused",
    ),
    CodeMeaning(
        "CAL-410",
        "refused",
        "The number of distortion coefficients does not match the distortion model.",
        "Enter the distortion model of these coefficients.",
    ),
    CodeMeaning(
        "CAL-411",
        "wrong",
        "The focal length, the centre or the distortion is implausible for the image.",
        "Check the image size, and whether rows and columns are swapped.",
        as_error="refused",
    ),
    CodeMeaning(
        "CAL-412",
        "less",
        "The calibration does not place a sensor that is recorded or required.",
        "Add the sensor, with its frame_id or channel.",
    ),
    CodeMeaning("CAL-413", "refused", "Two sensors have the same channel.", "Rename one of the two sensors."),
    CodeMeaning(
        "CAL-414",
        "wrong",
        "/tf_static and the calibration disagree; the calibration is used.",
        "Check which of the two is right.",
    ),
    CodeMeaning(
        "CAL-415",
        "refused",
        "A footprint or a self box has no extent, or exceeds the size of a vehicle.",
        "Check the units, and the minimum and maximum.",
    ),
    CodeMeaning("CAL-416", "refused", "A number is NaN or infinite.", "Correct the value that the message names."),
    CodeMeaning(
        "CAL-417",
        "wrong",
        "Several sensors have exactly the LiDAR's position, so they were probably never measured.",
        "Measure the extrinsics of these sensors.",
    ),
    CodeMeaning(
        "CAL-418",
        "wrong",
        "The recording lies outside the calibration's period of validity. A calibration with an empty period "
        "is refused.",
        "Assign the calibration version that was valid on that day.",
        as_error="refused",
    ),
    CodeMeaning(
        "CAL-419",
        "wrong",
        "The LiDAR lies below the ground.",
        "Invert ego_from_lidar, or put the ego origin on the ground.",
    ),
    CodeMeaning("CAL-420", "refused", "The file is too large for a calibration.", "Upload the calibration alone."),
    CodeMeaning("CAL-421", "refused", "The file is not plain YAML.", "Correct the line that the message names."),
    CodeMeaning(
        "CAL-422",
        "refused",
        "A key is missing or unknown, or its value has the wrong type.",
        "Correct the key that the message names.",
    ),
    CodeMeaning(
        "CAL-423",
        "refused",
        "The file has none of the supported formats.",
        "Write the calibration in the native YAML format.",
    ),
    CodeMeaning(
        "CAL-424",
        "refused",
        "The files describe only part of a robot.",
        "Add a rig.yaml with the parts that the message names.",
    ),
    CodeMeaning(
        "CAL-425",
        "refused",
        "Ambiguous: several entries in the files fit.",
        "Choose one entry, or leave the others out.",
    ),
    CodeMeaning(
        "CAL-426",
        "less",
        "A lens is described incompletely, so points are not projected with it, or only as if undistorted.",
        "Add the camera_info of the lens.",
    ),
    CodeMeaning(
        "CAL-427",
        "refused",
        "The lens model is not supported.",
        "Calibrate with a pinhole model and a distortion model that the message lists.",
    ),
    CodeMeaning(
        "CAL-428",
        "refused",
        "The zip or folder is not a bundle of calibration files.",
        "Put only the calibration files into it.",
    ),
    CodeMeaning("CAL-429", "refused", "Two files contradict each other.", "Leave one of the two files out."),
    CodeMeaning(
        "CAL-430",
        "wrong",
        "It is unclear whether a camera's frame is a link frame or an optical frame; an optical frame is assumed.",
        "Name the optical frame.",
    ),
    CodeMeaning("CAL-431", "none", "Some files were ignored.", "No action is needed."),
    CodeMeaning(
        "CAL-432",
        "wrong",
        "A time lag in the file is not applied, because the format does not define the reference clock.",
        "Enter time_offset_ns.",
    ),
    CodeMeaning(
        "CAL-433",
        "wrong",
        "The ground does not lie at the ego origin. If the distance exceeds 0.15 m, nothing is labelled.",
        "Enter the mount that the message names, or use --ground auto for this run.",
    ),
    CodeMeaning(
        "CAL-434",
        "none",
        "The LiDAR's mount was corrected with the measured ground, as ground auto requires.",
        "Enter the corrected mount into the calibration.",
    ),
    CodeMeaning(
        "CAL-435",
        "none",
        "Too few sweeps show the ground, so the height of the mount was not checked.",
        "No action is needed.",
    ),
    CodeMeaning(
        "CAL-436",
        "none",
        "The calibration has no footprint; the footprint of the paper's robot is used.",
        "Enter footprint if the robot has another size.",
    ),
    CodeMeaning(
        "CAL-437",
        "none",
        "The calibration places a sensor that has no topic.",
        "Ignore this if the sensor was not recorded.",
    ),
    CodeMeaning(
        "CAL-438",
        "none",
        "/tf_static places all sensors at one point, so the calibration's positions are used.",
        "Enter the mounts in the driver's launch file.",
    ),
    CodeMeaning(
        "CAL-439",
        "none",
        "/tf_static places a radar that the calibration does not place.",
        "Add the radar to the calibration if you know its position.",
    ),
    CodeMeaning(
        "CAL-440",
        "none",
        "According to the sweeps, the base frame of the LiDAR in /tf_static is not on the ground.",
        "Enter the mount that the message names, or process with ground auto (preselected on the page).",
    ),
    CodeMeaning("CAL-450", "refused", "The file is XML but not a URDF.", "Upload the robot's expanded URDF."),
    CodeMeaning(
        "CAL-451", "refused", "The file is an unexpanded xacro.", "Expand it with the command that the message names."
    ),
    CodeMeaning(
        "CAL-452",
        "wrong",
        "Movable joints of the URDF are read at position zero.",
        "If a joint was not at zero, place the sensor behind it with a rig.yaml.",
    ),
    CodeMeaning(
        "CAL-453",
        "refused",
        "The file is a template of `stone calibration init` that still contains FILL_IN.",
        "Measure the values that the message names, and replace each FILL_IN.",
    ),
)
