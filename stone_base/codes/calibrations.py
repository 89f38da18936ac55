"""Meanings of CAL codes: intrinsics, extrinsics, and the files that hold them."""

from stone_base.codes.meaning import CodeMeaning

MEANINGS = (
    CodeMeaning(
        "CAL-401",
        "wrong",
        "A rotation is rounded and the nearest one is used; too far from any rotation it is refused.",
        "Enter it with more digits.",
        as_error="refused",
    ),
    CodeMeaning(
        "CAL-402",
        "wrong",
        "A quaternion is not of unit length, or seems to be in the order x, y, z, w; too far from unit length"
        " it is refused.",
        "Enter w first, with more digits.",
        as_error="refused",
    ),
    CodeMeaning(
        "CAL-403",
        "wrong",
        "A camera was calibrated for another image size than it recorded, so points are projected to the wrong pixels.",
        "Give the intrinsics of the recorded size.",
    ),
    CodeMeaning(
        "CAL-404",
        "wrong",
        "A camera looks away from where its name says, or a transform is inverted.",
        "Invert the transform, or check the mount.",
    ),
    CodeMeaning(
        "CAL-405",
        "wrong",
        "Nobody says where the frame of the poses is, so it is taken for the ego frame; a calibration whose "
        "sensor has no chain to the LiDAR is refused.",
        "Add the sensor with that frame_id to the calibration, or use --poses-frame.",
        as_error="refused",
    ),
    CodeMeaning(
        "CAL-406",
        "wrong",
        "A camera fires when the direction of another one is scanned: two are swapped.",
        "Check topics and plugs of the two.",
    ),
    CodeMeaning(
        "CAL-407",
        "refused",
        "The last row of a matrix is not 0 0 0 1.",
        "Check rows and columns: it may be transposed.",
    ),
    CodeMeaning("CAL-408", "refused", "A transform mirrors.", "Check the signs and the order of its axes."),
    CodeMeaning(
        "CAL-409",
        "wrong",
        "A sensor is more than 10 m from the LiDAR; beyond 100 m it is refused.",
        "Check the unit: it must be metres.",
        as_error="refused",
    ),
    CodeMeaning(
        "CAL-410",
        "refused",
        "The distortion has another number of coefficients than its model.",
        "Name the model that the coefficients belong to.",
    ),
    CodeMeaning(
        "CAL-411",
        "wrong",
        "Focal length, centre or distortion can hardly belong to the image.",
        "Check the image size, and whether rows and columns are swapped.",
        as_error="refused",
    ),
    CodeMeaning(
        "CAL-412",
        "less",
        "The calibration does not place a sensor that is recorded or needed.",
        "Add it, with its frame_id or channel.",
    ),
    CodeMeaning("CAL-413", "refused", "Two sensors have the same channel.", "Rename one."),
    CodeMeaning(
        "CAL-414",
        "wrong",
        "tf_static and the calibration disagree; the calibration is used.",
        "Find out which is right.",
    ),
    CodeMeaning(
        "CAL-415",
        "refused",
        "A footprint or a self box has no extent, or more than a vehicle's.",
        "Check units, and minimum and maximum.",
    ),
    CodeMeaning("CAL-416", "refused", "A number is NaN or infinite.", "Correct the value that is named."),
    CodeMeaning(
        "CAL-417",
        "wrong",
        "Several sensors are exactly at the LiDAR's place, as if nobody had measured them.",
        "Measure their extrinsics.",
    ),
    CodeMeaning(
        "CAL-418",
        "wrong",
        "The recording lies outside the time in which the calibration is valid; a calibration that is valid "
        "at no time is refused.",
        "Assign the version of that day.",
        as_error="refused",
    ),
    CodeMeaning(
        "CAL-419",
        "wrong",
        "The LiDAR lies below the ground.",
        "Invert ego_from_lidar, or put the ego origin on the ground.",
    ),
    CodeMeaning("CAL-420", "refused", "The file is larger than any calibration.", "Give the calibration alone."),
    CodeMeaning("CAL-421", "refused", "The file is not plain YAML.", "Correct the line that is named."),
    CodeMeaning(
        "CAL-422", "refused", "A key is missing, unknown, or of the wrong kind.", "Correct the key that is named."
    ),
    CodeMeaning(
        "CAL-423", "refused", "The file is in none of the formats that are read.", "Write it in the native YAML format."
    ),
    CodeMeaning(
        "CAL-424", "refused", "The files describe only a part of a robot.", "Add a rig.yaml with what is named."
    ),
    CodeMeaning(
        "CAL-425",
        "refused",
        "Several things in the files could be the one that is meant.",
        "Say which, or leave the others out.",
    ),
    CodeMeaning(
        "CAL-426",
        "less",
        "A lens is not described completely, so points are not projected by it, or only as if undistorted.",
        "Add its camera_info.",
    ),
    CodeMeaning(
        "CAL-427",
        "refused",
        "The lens model is not supported.",
        "Calibrate with a pinhole model and one of the distortions that are named.",
    ),
    CodeMeaning(
        "CAL-428",
        "refused",
        "The zip or folder is not a bundle of calibration files.",
        "Put the calibration files into it, and no others.",
    ),
    CodeMeaning("CAL-429", "refused", "Two files contradict each other.", "Leave one of them out."),
    CodeMeaning(
        "CAL-430",
        "wrong",
        "It is unclear whether a camera's frame is a link or optical; it is taken as optical.",
        "Name the optical frame.",
    ),
    CodeMeaning("CAL-431", "none", "Some files were not looked at.", "Nothing."),
    CodeMeaning(
        "CAL-432",
        "wrong",
        "A time lag in the file is not applied, for the format does not say to which clock it refers.",
        "Set time_offset_ns.",
    ),
    CodeMeaning(
        "CAL-433",
        "wrong",
        "The ground does not lie at the ego origin; beyond 0.15 m nothing is labelled.",
        "Enter the mount that is named, or use --ground auto for this run.",
    ),
    CodeMeaning(
        "CAL-434",
        "none",
        "The LiDAR's mount was corrected by the measured ground, as ground auto asks.",
        "Enter it into the calibration.",
    ),
    CodeMeaning(
        "CAL-435", "none", "The ground was seen in too few sweeps to check the height of the mount.", "Nothing."
    ),
    CodeMeaning(
        "CAL-436",
        "none",
        "No footprint is given; that of the paper's robot is taken.",
        "Enter footprint where the robot has another size.",
    ),
    CodeMeaning(
        "CAL-437", "none", "The calibration places a sensor that has no topic.", "Nothing, if it was not recorded."
    ),
    CodeMeaning(
        "CAL-438",
        "none",
        "/tf_static has every sensor in one point: its positions were not entered, and the calibration's are used.",
        "Enter the mounts in the driver's launch file.",
    ),
    CodeMeaning(
        "CAL-439",
        "none",
        "A radar that the calibration does not place is placed by /tf_static.",
        "Add it to the calibration if its position is known.",
    ),
    CodeMeaning(
        "CAL-440",
        "none",
        "By the sweeps, the base on which /tf_static has the LiDAR is not on the ground.",
        "Enter the mount that is named, or process with ground auto (on the page it is chosen already).",
    ),
    CodeMeaning("CAL-450", "refused", "The file begins as XML and is not a URDF.", "Send the robot's expanded URDF."),
    CodeMeaning(
        "CAL-451", "refused", "The file is a xacro that is not expanded.", "Expand it by the command that is named."
    ),
    CodeMeaning(
        "CAL-452",
        "wrong",
        "Joints of the URDF that move are read at zero.",
        "Place a sensor behind one by a rig.yaml, if the joint was not at zero.",
    ),
    CodeMeaning(
        "CAL-453",
        "refused",
        "The file is a template of `stone calibration init` with values that are not filled in.",
        "Measure the values that are named, and write them in the place of FILL_IN.",
    ),
)
