"""Meanings of SYN codes: poses, the track, and recordings of one run."""

from stone_base.codes.meaning import CodeMeaning

MEANINGS = (
    CodeMeaning(
        "SYN-501",
        "less",
        "Some sweeps have no pose and are not frames. If no sweep has a pose, the run is refused.",
        "See the reasons on the sequence's Track page, and fix gaps and clocks of the pose source.",
        as_error="refused",
    ),
    CodeMeaning(
        "SYN-502",
        "refused",
        "The recording contains no pose of the robot.",
        "Record INS or odometry, pass a pose file with --poses, or use --odometry kiss-icp.",
    ),
    CodeMeaning(
        "SYN-503",
        "refused",
        "The recording has a pose source, but none of its samples can be used.",
        "Check whether the receiver had a solution, or use --odometry kiss-icp.",
    ),
    CodeMeaning(
        "SYN-504", "less", "Some frames have no sufficiently close message of a sensor.", "Check the sensor for gaps."
    ),
    CodeMeaning(
        "SYN-505", "less", "Sweeps with too few points have no pose.", "Check whether anything covered the LiDAR."
    ),
    CodeMeaning(
        "SYN-506",
        "wrong",
        "The vertical is unknown; the robot's own up direction at the start is used.",
        "Record an IMU, or start on level ground.",
    ),
    CodeMeaning(
        "SYN-507",
        "wrong",
        "The track breaks; the part after each break was moved until the surfaces matched.",
        "Check the moved parts and the pose source.",
    ),
    CodeMeaning(
        "SYN-508",
        "wrong",
        "The track breaks and could not be joined, so each part has its own map.",
        "Check the pose source.",
    ),
    CodeMeaning("SYN-509", "refused", "No LiDAR sweep can be used.", "Check the driver's stamps, fields and points."),
    CodeMeaning(
        "SYN-510",
        "refused",
        "The poses never change although the sweeps show motion. As a warning: the sweeps show no motion "
        "either, so the robot stood still.",
        "Choose another pose topic, or use --odometry kiss-icp. If the robot stood still, no action is needed.",
        as_warning="none",
    ),
    CodeMeaning(
        "SYN-511",
        "less",
        "Poses are too infrequent. Only sweeps at a pose are frames; if no sweep is at a pose, the run is refused.",
        "Record poses at 10 Hz or more, or use --odometry kiss-icp.",
        as_error="refused",
    ),
    CodeMeaning(
        "SYN-514",
        "none",
        "The poses drift in height. They were moved until ground that was seen twice had one height.",
        "No action is needed for these labels; check the pose source before the next run.",
    ),
    CodeMeaning(
        "SYN-515",
        "wrong",
        "According to the poses, the same ground has two heights, and slow drift does not explain this.",
        "Check the clock, mount and topic of the poses before you use the labels.",
    ),
    CodeMeaning(
        "SYN-516", "refused", "A line of a pose file is not a pose.", "Correct the line that the message names."
    ),
    CodeMeaning(
        "SYN-517",
        "refused",
        "A pose file does not match the recording or its calibration.",
        "Use the pose file of this run.",
    ),
    CodeMeaning(
        "SYN-518",
        "wrong",
        "Throughout the run, the poses face another direction than the robot drives: heading or pitch is biased.",
        "Correct the INS rotation in the calibration by the angle in the message.",
    ),
    CodeMeaning(
        "SYN-520",
        "none",
        "The recording was moved to the clock of the run's other recordings; the message names the source of "
        "the offset.",
        "No action is needed.",
    ),
    CodeMeaning(
        "SYN-521",
        "none",
        "The recording was moved by the requested offset, which was not measured.",
        "No action is needed.",
    ),
    CodeMeaning("SYN-522", "none", "Messages that two recordings contain are used once.", "No action is needed."),
    CodeMeaning(
        "SYN-523",
        "refused",
        "The clock offset of a recording cannot be measured.",
        "Set the offset with --clock-offset, or include a camera, radar or IMU in the recording.",
    ),
    CodeMeaning(
        "SYN-524",
        "refused",
        "The sensors of one recording have different clock offsets.",
        "Check mounts and stamps; choose the right offset with --clock-offset.",
    ),
    CodeMeaning(
        "SYN-525",
        "refused",
        "A recording does not overlap the others in time.",
        "Leave the recording out, or set its offset with --clock-offset.",
    ),
    CodeMeaning(
        "SYN-526",
        "refused",
        "The selected files cannot be recordings of one run.",
        "Leave out the file that the message names.",
    ),
    CodeMeaning(
        "SYN-527",
        "less",
        "A recording does not cover the whole run, so some frames lack its sensors.",
        "Check the recorder.",
    ),
    CodeMeaning("SYN-528", "less", "There is a gap between two recordings.", "Check the recorder."),
    CodeMeaning(
        "SYN-530",
        "refused",
        "The orientation of the poses does not follow the rotation in the registered sweeps or the gyro: the "
        "topic contains positions, not poses.",
        "Use the topic that the message names, record a filtered IMU, or use --odometry kiss-icp or course:TOPIC.",
    ),
    CodeMeaning(
        "SYN-531",
        "wrong",
        "The heading is the course over ground, as --odometry course:TOPIC requires; roll and pitch are 0.",
        "No action is needed for a robot that always drives forward on nearly level ground; otherwise record "
        "an attitude.",
    ),
    CodeMeaning(
        "SYN-532",
        "none",
        "The positions are far from the origin of their frame (UTM, ECEF), so the map has its own origin, "
        "which the message names.",
        "No action is needed.",
    ),
    CodeMeaning(
        "SYN-533",
        "refused",
        "The positions of the poses are latitude and longitude in degrees.",
        "Record positions in metres, or use --odometry kiss-icp.",
    ),
    CodeMeaning(
        "SYN-534",
        "refused",
        "The positions are ECEF, but the orientation is neither ECEF nor east, north, up.",
        "Record the poses in a local frame, or use --odometry course:TOPIC.",
    ),
    CodeMeaning(
        "SYN-535",
        "refused",
        "The poses of a run are too far apart for one map.",
        "Check the source for positions from other runs; record one run at a time.",
    ),
)
