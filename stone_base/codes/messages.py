"""Meanings of MSG and TOP codes: what messages hold, and which topics are used."""

from stone_base.codes.meaning import CodeMeaning

MEANINGS = (
    CodeMeaning(
        "MSG-301",
        "refused",
        "The lengths inside a message contradict its type or its size.",
        "Check the driver; copy the recording again if it was damaged on the way.",
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
        "Point clouds whose fields or sizes contradict each other are left out if their bytes do not decide; a wrong"
        " byte-order flag alone is ignored.",
        "Check the LiDAR's driver where there are many.",
    ),
    CodeMeaning(
        "MSG-304",
        "less",
        "Messages of one topic name several pairs of frames; those of the other pairs are left out.",
        "Give each source a topic of its own.",
    ),
    CodeMeaning(
        "MSG-305",
        "less",
        "Poses that are NaN, infinite or without a rotation are left out.",
        "Check the source of poses where there are many.",
    ),
    CodeMeaning(
        "MSG-306",
        "less",
        "An image is damaged, or of an encoding that is not read.",
        "Record mono, rgb, bgr, Bayer, YUV (yuv422, yuv422_yuy2, nv12, nv21, nv24), JPEG or PNG images.",
    ),
    CodeMeaning(
        "MSG-307",
        "less",
        "The definition of a message type cannot be read; its topic is left out.",
        "Record with the definitions of the driver's own package.",
    ),
    CodeMeaning(
        "MSG-308", "less", "A radar packet contradicts the ARS 548 interface.", "Check the radar's network and driver."
    ),
    CodeMeaning(
        "MSG-309",
        "none",
        "The recording's definition of a message type differs from the known one; the recording's is used.",
        "Nothing.",
    ),
    CodeMeaning(
        "MSG-310",
        "none",
        "The recording's definition of a message type cannot be read; the known one is used.",
        "Nothing, as long as the values are plausible.",
    ),
    CodeMeaning(
        "MSG-311",
        "less",
        "Messages that cannot be read, or have no stamp, are left out.",
        "Nothing for a few; check the driver where there are many.",
    ),
    CodeMeaning(
        "MSG-312", "less", "Point clouds without a point are left out.", "Check the LiDAR's power and network."
    ),
    CodeMeaning(
        "MSG-313",
        "refused",
        "The LiDAR's packets are of a model that is not decoded, or are damaged.",
        "Record the driver's point topic that the sentence names.",
        as_warning="less",
    ),
    CodeMeaning(
        "MSG-320",
        "none",
        "Clouds or images declare rows, sizes or steps that their own data refutes; the data is read.",
        "Correct the driver or the node that writes them (row_step is width times point_step).",
    ),
    CodeMeaning(
        "MSG-321",
        "less",
        "Points have no time of their sweep: unsigned times that wrapped are read as negative, single ones get the time"
        " between their neighbours, the others are left out.",
        "Nothing for a few; look at the LiDAR's time synchronisation where there are many.",
    ),
    CodeMeaning(
        "MSG-322",
        "wrong",
        "The point times of some sweeps cannot be read, so these are not deskewed: a turning robot smears them.",
        "Look at the LiDAR's time synchronisation and driver.",
    ),
    CodeMeaning(
        "MSG-330",
        "refused",
        "A CompressedPointCloud2 is compressed in a format that is not read.",
        "Record with zlib or zstd, or the PointCloud2 topic; point_cloud_transport's republish makes it.",
        as_warning="less",
    ),
    CodeMeaning(
        "TOP-101",
        "refused",
        "There is no LiDAR topic that can be used; topics that hold points in another form are named.",
        "Record sensor_msgs/PointCloud2 from the driver, or the topic that the sentence names.",
    ),
    CodeMeaning(
        "TOP-102",
        "wrong",
        "Points have no time that can be used, so sweeps are not deskewed: a turning robot smears them.",
        "Configure the driver to write a time for each point.",
    ),
    CodeMeaning(
        "TOP-103",
        "refused",
        "Nothing in the recording says where the robot was.",
        "Record INS or odometry, give a file with --poses, or use --odometry kiss-icp.",
    ),
    CodeMeaning(
        "TOP-104",
        "refused",
        "The topic that was asked for has no messages, or is of a type that cannot be used.",
        "Choose one that stone inspect lists.",
    ),
    CodeMeaning(
        "TOP-110",
        "refused",
        "Several topics fit one role, and none is chosen by guessing.",
        "Choose one with --topic ROLE=TOPIC; --save-topics keeps the choice for the next recording.",
    ),
    CodeMeaning(
        "TOP-111",
        "none",
        "A topic that the robot's topic profile names cannot be used here; its role was filled as without a profile.",
        "Check which topic was taken, and save the topic profile again.",
    ),
    CodeMeaning(
        "TOP-112",
        "less",
        "Names do not tell in which direction a camera or radar looks, so it has no channel.",
        "Name it with --topic CAM_FRONT=TOPIC.",
    ),
    CodeMeaning(
        "TOP-113",
        "refused",
        "A topic profile names an unknown role, an impossible topic, or one topic twice.",
        "Correct the line that is named.",
    ),
    CodeMeaning("TOP-114", "refused", "The file is not a topic profile.", "Write it by stone inspect --save-topics."),
    CodeMeaning(
        "TOP-115",
        "less",
        "Messages name no frame, so the sensor cannot be found in the calibration by its frame.",
        "Set frame_id in the driver.",
    ),
    CodeMeaning(
        "TOP-116",
        "none",
        "Sweeps are decoded from packets with the maker's default angles, which differ from this unit's by "
        "some tenths of a degree.",
        "Nothing; record the driver's points to have the angles of this unit.",
    ),
    CodeMeaning(
        "TOP-117",
        "none",
        "A radar has its channel of its yaw in /tf_static, or its name contradicts that yaw.",
        "Check which channel it has; name another with --topic CHANNEL=TOPIC.",
    ),
    CodeMeaning(
        "TOP-120",
        "none",
        "Points of a further LiDAR are in a form that is not read; another LiDAR is used.",
        "Nothing, or record the driver's topic that the sentence names.",
    ),
    CodeMeaning(
        "TOP-121",
        "less",
        "A camera's pictures are recorded as video, which is not read; frames have none of it.",
        "Record Image or CompressedImage, or convert the topic by image_transport's republish.",
    ),
)
