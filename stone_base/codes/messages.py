"""Meanings of MSG and TOP codes: the content of messages, and the choice of topics."""

from stone_base.codes.meaning import CodeMeaning

MEANINGS = (
    CodeMeaning(
        "MSG-301",
        "refused",
        "The lengths inside a message contradict its type or its size.",
        "Check the driver; if the recording was damaged in transfer, copy it again.",
        as_warning="less",
    ),
    CodeMeaning(
        "MSG-302",
        "refused",
        "A message is big-endian, which no current recorder writes.",
        "Convert the recording, or check the driver.",
        as_warning="less",
    ),
    CodeMeaning(
        "MSG-303",
        "less",
        "Point clouds with contradictory fields or sizes are left out, unless their bytes resolve the "
        "contradiction. A wrong byte-order flag alone is ignored.",
        "If there are many, check the LiDAR's driver.",
    ),
    CodeMeaning(
        "MSG-304",
        "less",
        "Messages of one topic name several pairs of frames; messages with the other pairs are left out.",
        "Use a separate topic for each source.",
    ),
    CodeMeaning(
        "MSG-305",
        "less",
        "Poses that are NaN, infinite or without a rotation are left out.",
        "If there are many, check the pose source.",
    ),
    CodeMeaning(
        "MSG-306",
        "less",
        "An image is damaged or has an unsupported encoding.",
        "Record mono, rgb, bgr, Bayer, YUV (yuv422, yuv422_yuy2, nv12, nv21, nv24), JPEG or PNG images.",
    ),
    CodeMeaning(
        "MSG-307",
        "less",
        "The definition of a message type cannot be read; its topic is left out.",
        "Record with the definitions from the driver's own package.",
    ),
    CodeMeaning(
        "MSG-308", "less", "A radar packet contradicts the ARS 548 interface.", "Check the radar's network and driver."
    ),
    CodeMeaning(
        "MSG-309",
        "none",
        "The recording's definition of a message type differs from the known definition; the recording's "
        "definition is used.",
        "No action is needed.",
    ),
    CodeMeaning(
        "MSG-310",
        "none",
        "The recording's definition of a message type cannot be read; the known definition is used.",
        "No action is needed if the values are plausible.",
    ),
    CodeMeaning(
        "MSG-311",
        "less",
        "Messages that cannot be read or have no stamp are left out.",
        "Ignore a few messages; if there are many, check the driver.",
    ),
    CodeMeaning("MSG-312", "less", "Empty point clouds are left out.", "Check the LiDAR's power and network."),
    CodeMeaning(
        "MSG-313",
        "refused",
        "The LiDAR's packets are damaged or come from an unsupported model.",
        "Record the driver's point topic that the message names.",
        as_warning="less",
    ),
    CodeMeaning(
        "MSG-320",
        "none",
        "The declared rows, sizes or steps of clouds or images contradict their data; the data is read.",
        "Correct the driver or node that writes them (row_step is width times point_step).",
    ),
    CodeMeaning(
        "MSG-321",
        "less",
        "Some points have no time within their sweep. Unsigned times that wrapped are read as negative, "
        "single points get the time between their neighbours, and the others are left out.",
        "Ignore a few points; if there are many, check the LiDAR's time synchronisation.",
    ),
    CodeMeaning(
        "MSG-322",
        "wrong",
        "The point times of some sweeps cannot be read, so these sweeps are not deskewed; rotation smears them.",
        "Check the LiDAR's time synchronisation and driver.",
    ),
    CodeMeaning(
        "MSG-330",
        "refused",
        "The compression format of a CompressedPointCloud2 is not supported.",
        "Record with zlib or zstd, or record the PointCloud2 topic (from point_cloud_transport's republish).",
        as_warning="less",
    ),
    CodeMeaning(
        "TOP-101",
        "refused",
        "The recording has no usable LiDAR topic; the message names topics with points in another form.",
        "Record sensor_msgs/PointCloud2 from the driver, or the topic that the message names.",
    ),
    CodeMeaning(
        "TOP-102",
        "wrong",
        "Points have no usable time, so sweeps are not deskewed; rotation smears them.",
        "Configure the driver to write a time for each point.",
    ),
    CodeMeaning(
        "TOP-103",
        "refused",
        "The recording contains no pose of the robot.",
        "Record INS or odometry, pass a pose file with --poses, or use --odometry kiss-icp.",
    ),
    CodeMeaning(
        "TOP-104",
        "refused",
        "The requested topic has no messages, or its type cannot be used.",
        "Choose a topic that `stone inspect` lists.",
    ),
    CodeMeaning(
        "TOP-110",
        "refused",
        "Several topics fit one role, and the choice is never guessed.",
        "Choose a topic with --topic ROLE=TOPIC; --save-topics saves the choice for the next recording.",
    ),
    CodeMeaning(
        "TOP-111",
        "none",
        "A topic in the robot's topic profile cannot be used here; its role was assigned as without a profile.",
        "Check which topic was used, and save the topic profile again.",
    ),
    CodeMeaning(
        "TOP-112",
        "less",
        "The names do not show the direction of a camera or radar, so it has no channel.",
        "Assign a channel with --topic CAM_FRONT=TOPIC.",
    ),
    CodeMeaning(
        "TOP-113",
        "refused",
        "A topic profile names an unknown role or an impossible topic, or repeats a topic.",
        "Correct the line that the message names.",
    ),
    CodeMeaning(
        "TOP-114", "refused", "The file is not a topic profile.", "Create one with `stone inspect --save-topics`."
    ),
    CodeMeaning(
        "TOP-115",
        "less",
        "The messages name no frame, so their sensor cannot be found in the calibration by frame.",
        "Set frame_id in the driver.",
    ),
    CodeMeaning(
        "TOP-116",
        "none",
        "Sweeps are decoded from packets with the manufacturer's default angles, which differ from this "
        "unit's angles by tenths of a degree.",
        "No action is needed; to use this unit's angles, record the driver's points.",
    ),
    CodeMeaning(
        "TOP-117",
        "none",
        "A radar's channel comes from its yaw in /tf_static, or its name contradicts that yaw.",
        "Check the radar's channel; change it with --topic CHANNEL=TOPIC.",
    ),
    CodeMeaning(
        "TOP-120",
        "none",
        "Points of another LiDAR have an unsupported form; a different LiDAR is used.",
        "No action is needed; to use it, record the driver's topic that the message names.",
    ),
    CodeMeaning(
        "TOP-121",
        "less",
        "A camera is recorded as video, which is not supported, so frames have no images from it.",
        "Record Image or CompressedImage, or convert the topic with image_transport's republish.",
    ),
)
