"""Meanings of SYN codes: poses, the track, and recordings of one run."""

from stone_base.codes.meaning import CodeMeaning

MEANINGS = (
    CodeMeaning(
        "SYN-501",
        "less",
        "Some sweeps have no pose and are not frames; where none has one, the run is refused.",
        "Look at the reasons on the sequence's Track page; fix gaps and clocks of the pose source.",
        as_error="refused",
    ),
    CodeMeaning(
        "SYN-502",
        "refused",
        "Nothing in the recording says where the robot was.",
        "Record INS or odometry, give a file with --poses, or use --odometry kiss-icp.",
    ),
    CodeMeaning(
        "SYN-503",
        "refused",
        "There is a pose source, but none of its samples can be used.",
        "Check whether the receiver had a solution; or use --odometry kiss-icp.",
    ),
    CodeMeaning(
        "SYN-504", "less", "Some frames have no message of a sensor near enough in time.", "Check the sensor for gaps."
    ),
    CodeMeaning("SYN-505", "less", "Sweeps with too few points gave no pose.", "Check what covered the LiDAR."),
    CodeMeaning(
        "SYN-506",
        "wrong",
        "Nothing tells where up is; the robot's own up at the start is taken.",
        "Record an IMU, or begin on level ground.",
    ),
    CodeMeaning(
        "SYN-507",
        "wrong",
        "The track breaks, and what follows was moved until the surfaces fit.",
        "Check what was moved, and the pose source.",
    ),
    CodeMeaning(
        "SYN-508",
        "wrong",
        "The track breaks and could not be joined: each part is a map of its own.",
        "Check the pose source.",
    ),
    CodeMeaning(
        "SYN-509", "refused", "No sweep of the LiDAR can be used.", "Check the driver: stamps, fields, points."
    ),
    CodeMeaning(
        "SYN-510",
        "refused",
        "The poses never change although the sweeps show motion. A warning says that the sweeps do not move "
        "either: the robot stood.",
        "Choose another pose topic, or use --odometry kiss-icp; nothing where the robot stood.",
        as_warning="none",
    ),
    CodeMeaning(
        "SYN-511",
        "less",
        "Poses come too rarely; only sweeps at a pose are frames, and without any the run is refused.",
        "Record poses at 10 Hz or more, or use --odometry kiss-icp.",
        as_error="refused",
    ),
    CodeMeaning(
        "SYN-514",
        "none",
        "The poses drift in height, and were moved until ground seen twice lies at one height.",
        "Nothing for these labels; check the pose source for the next run.",
    ),
    CodeMeaning(
        "SYN-515",
        "wrong",
        "The same ground lies at two heights by the poses, and this is not a slow drift.",
        "Check clock, mount and topic of the poses before you trust the labels.",
    ),
    CodeMeaning(
        "SYN-516", "refused", "A file of poses contains a line that is not a pose.", "Correct the line that is named."
    ),
    CodeMeaning(
        "SYN-517",
        "refused",
        "A file of poses does not belong to the recording or its calibration.",
        "Give the file of this run.",
    ),
    CodeMeaning(
        "SYN-518",
        "wrong",
        "The poses face another way than the robot drives, all along the run: heading or pitch is biased.",
        "Correct the rotation of the INS in the calibration by the angle that is given.",
    ),
    CodeMeaning(
        "SYN-520",
        "none",
        "The recording was put on the clock of the other recordings of the run; the sentence says how the "
        "offset is known.",
        "Nothing.",
    ),
    CodeMeaning(
        "SYN-521", "none", "The recording was moved by the offset that was asked for; nobody measured it.", "Nothing."
    ),
    CodeMeaning("SYN-522", "none", "Messages that two recordings both hold are used once.", "Nothing."),
    CodeMeaning(
        "SYN-523",
        "refused",
        "The clock offset of a recording cannot be measured.",
        "Give it with --clock-offset, or record a camera, radar or IMU in it.",
    ),
    CodeMeaning(
        "SYN-524",
        "refused",
        "Sensors of one recording give different clock offsets.",
        "Check mounts and stamps; --clock-offset says which is right.",
    ),
    CodeMeaning(
        "SYN-525",
        "refused",
        "A recording was not made while the others were.",
        "Leave it out, or give its offset with --clock-offset.",
    ),
    CodeMeaning(
        "SYN-526", "refused", "The named files cannot be the recordings of one run.", "Leave out the one that is named."
    ),
    CodeMeaning(
        "SYN-527",
        "less",
        "A recording does not cover the whole run; frames there lack its sensors.",
        "Check the recorder.",
    ),
    CodeMeaning("SYN-528", "less", "Nothing was recorded between two recordings.", "Check the recorder."),
    CodeMeaning(
        "SYN-530",
        "refused",
        "The orientation of the poses does not turn as the robot does, by its registered sweeps or its gyro: these are "
        "positions, and no poses.",
        "Take the topic that the sentence names, record a filtered IMU, or use --odometry kiss-icp or course:TOPIC.",
    ),
    CodeMeaning(
        "SYN-531",
        "wrong",
        "The heading is the course over ground, as --odometry course:TOPIC chooses; roll and pitch are 0.",
        "Nothing for a robot that always drives forward on nearly level ground; else record an attitude.",
    ),
    CodeMeaning(
        "SYN-532",
        "none",
        "The positions are far from the origin of their frame (UTM, ECEF); the map has an origin of its own, which the "
        "sentence names.",
        "Nothing.",
    ),
    CodeMeaning(
        "SYN-533",
        "refused",
        "The positions of the poses are latitude and longitude in degrees.",
        "Record them in metres, or use --odometry kiss-icp.",
    ),
    CodeMeaning(
        "SYN-534",
        "refused",
        "The positions are ECEF, but the orientation is neither in ECEF nor in east, north, up.",
        "Record the poses in a local frame, or use --odometry course:TOPIC.",
    ),
    CodeMeaning(
        "SYN-535",
        "refused",
        "The poses of a run lie farther apart than a map reaches.",
        "Check the source for positions that are not of this run; record a run at a time.",
    ),
)
